"""Prints the share of the library's lines and branches that ran; the report has each file.

Usage: coverage_summary.py ROOT FOLDER, where FOLDER has the data of all processes.
"""

import json
import sys
from pathlib import Path

import coverage


def main():
    root, folder = (Path(word).resolve() for word in sys.argv[1:])
    config = str(root / "pyproject.toml")
    data = coverage.Coverage(data_file=str(folder / "data"), config_file=config)
    data.combine([str(folder)])
    with (folder / "report.txt").open("w") as file:
        data.report(file=file, show_missing=True)
    data.json_report(outfile=str(folder / "coverage.json"))
    totals = json.loads((folder / "coverage.json").read_text())["totals"]
    lines = 100 * totals["covered_lines"] / totals["num_statements"]
    branches = 100 * totals["covered_branches"] / totals["num_branches"]
    print(f"coverage: {lines:.1f} % of lines, {branches:.1f} % of branches; {folder}/report.txt")


if __name__ == "__main__":
    main()
