"""The study as a program: `python3 -m bullet_lab.studies.dock_campaign`."""

from bullet_lab.entry import run

if __name__ == "__main__":
    run("bullet_lab.studies.dock_campaign.study")
