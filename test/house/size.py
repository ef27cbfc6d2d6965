"""Prints how large the library is: tokens, tokens in a line of code, lines and files by folder.

Tokens are names, operators, numbers and strings; comments and docstrings do not count.
"""

import ast
import sys
import tokenize
from collections import Counter
from pathlib import Path

COUNTED = (tokenize.NAME, tokenize.OP, tokenize.NUMBER, tokenize.STRING)
COLUMNS = ("tokens", "per line", "lines", "files")


def docstrings(text):
    """Return where strings begin that are statements by themselves."""
    return {
        (node.lineno, node.col_offset)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    }


def size_of(path):
    """Return the numbers of tokens, lines of code and lines of a file."""
    text = path.read_bytes()
    left_out = docstrings(text)
    tokens = [
        token
        for token in tokenize.tokenize(iter(text.splitlines(True)).__next__)
        if token.type in COUNTED and token.start not in left_out
    ]
    code = {line for token in tokens for line in range(token.start[0], token.end[0] + 1)}
    return Counter(tokens=len(tokens), code=len(code), lines=text.count(b"\n"), files=1)


def show(name, size):
    """Print a row of the table."""
    density = size["tokens"] / max(1, size["code"])
    print(f"{name:36}{size['tokens']:9}{density:9.2f}{size['lines']:9}{size['files']:9}")


def main():
    """Print the table of a folder, of the library by default."""
    root = Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).parents[2] / "src" / "bullet_lab"
    folders = {}
    for path in sorted(root.rglob("*.py")):
        folder = str(path.parent.relative_to(root))
        folders[folder] = folders.get(folder, Counter()) + size_of(path)
    print(f"{'':36}" + "".join(f"{name:>9}" for name in COLUMNS))
    for folder, size in folders.items():
        show(folder, size)
    show("all", sum(folders.values(), Counter()))


if __name__ == "__main__":
    main()
