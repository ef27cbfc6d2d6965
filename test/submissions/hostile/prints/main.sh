#!/bin/bash
# Prints without an end.
exec yes "the robot is at the corner"
