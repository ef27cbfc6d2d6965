#!/bin/bash
# Fills the disk.
exec dd if=/dev/zero of=much bs=1M
