"""The job `verify`: do the results of all jobs repeat, on this machine and on others?"""
