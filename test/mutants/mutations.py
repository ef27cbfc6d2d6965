"""Small mistakes that can be put into a module: what mutation testing changes."""

from __future__ import annotations

import ast
import copy
from dataclasses import dataclass

import yaml

# What the classes of ast of these names may become.
OTHERS = """
Lt: [LtE, GtE]
LtE: [Lt, Gt]
Gt: [GtE, LtE]
GtE: [Gt, Lt]
Eq: [NotEq]
NotEq: [Eq]
Is: [IsNot]
IsNot: [Is]
In: [NotIn]
NotIn: [In]
Add: [Sub]
Sub: [Add]
Mult: [Div]
Div: [Mult]
FloorDiv: [Mult]
Mod: [Mult]
Pow: [Mult]
And: [Or]
Or: [And]
USub: [UAdd]
"""
OPERATORS = {
    getattr(ast, name): [getattr(ast, other) for other in others]
    for name, others in yaml.safe_load(OTHERS).items()
}
FUNCTIONS = yaml.safe_load("""
min: max
max: min
sin: cos
cos: sin
any: all
all: any
minimum: maximum
maximum: minimum
""")
# Above, a number is doubled, since one more would hardly change it.
ONE_MORE_UP_TO = 100


@dataclass(frozen=True)
class Mutant:
    """One mistake in a file.

    Attributes:
        file: path below the package's root.
        line: where it is.
        node: number of the node of the syntax tree that is replaced, as `nodes_of` counts.
        choice: which of that node's mutations.
        text: what is changed into what.
    """

    file: str
    line: int
    node: int
    choice: int
    text: str


def nodes_of(tree):
    """Return the nodes that run: no annotations, decorators, docstrings and texts."""
    found, left_out = [], []

    def visit(node):
        if node in left_out:
            return
        found.append(node)
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "reshape":
            # Of -1; any negative number is the length that is left.
            left_out.extend(one.operand for one in node.args if isinstance(one, ast.UnaryOp))
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list"):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                    visit(child)

    visit(tree)
    return found


def replaced(node, **fields):
    """Return a copy of a node with other fields."""
    new = copy.copy(node)
    for name, value in fields.items():
        setattr(new, name, value)
    return new


def is_real(node, reals):
    """Return whether an expression has a real number in it, 0 aside; `reals` are names of some."""
    parts = list(ast.walk(node))
    values = [part.value for part in parts if isinstance(part, ast.Constant)]
    names = {part.id for part in parts if isinstance(part, ast.Name)}
    return bool(names & reals) or any(value and isinstance(value, float) for value in values)


def reals_of(tree):
    """Return the names of a module's real numbers."""
    found = set()
    for node in tree.body:
        if isinstance(node, ast.Assign) and is_real(node.value, found):
            names = (part for target in node.targets for part in ast.walk(target))
            found |= {part.id for part in names if isinstance(part, ast.Name)}
    return found


def mutations(node, reals):
    """Yield what a node may become, each with a description; `reals` are the module's.

    Whether `<` or `<=` stands before a real number shows only where both sides are equal to the
    last bit, which no measured number is.
    """
    if isinstance(node, ast.Compare):
        sides = [is_real(side, reals) for side in (node.left, *node.comparators)]
        for place, op in enumerate(node.ops):
            kinds = OPERATORS[type(op)]
            for kind in kinds[-1:] if any(sides[place : place + 2]) else kinds:
                ops = node.ops[:place] + [kind()] + node.ops[place + 1 :]
                yield f"{type(op).__name__} to {kind.__name__}", replaced(node, ops=ops)
    elif isinstance(node, (ast.BinOp, ast.AugAssign, ast.BoolOp, ast.UnaryOp)):
        for kind in OPERATORS.get(type(node.op), ()):
            yield f"{type(node.op).__name__} to {kind.__name__}", replaced(node, op=kind())
    elif isinstance(node, ast.Constant):
        yield from other_constants(node)
    elif isinstance(node, (ast.If, ast.IfExp)):
        opposite = ast.UnaryOp(op=ast.Not(), operand=node.test)
        yield "condition to its opposite", replaced(node, test=opposite)
    elif isinstance(node, ast.Return) and node.value is not None:
        value = node.value.value if isinstance(node.value, ast.Constant) else ...
        # To nearly every caller, None, False and an empty text say the same.
        if not (value is None or value is False or value == ""):
            yield "return value to None", replaced(node, value=ast.Constant(None))
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield "call left out", ast.Pass()
    elif isinstance(node, ast.Raise):
        yield "raise left out", ast.Pass()
    elif isinstance(node, ast.Call):
        yield from other_functions(node)


def other_constants(node):
    """Yield other values of a truth value or number."""
    value = node.value
    if isinstance(value, bool):
        yield f"{value} to {not value}", replaced(node, value=not value)
    elif isinstance(value, (int, float)):
        new = value + 1 if abs(value) < ONE_MORE_UP_TO else 2 * value
        yield f"{value} to {new}", replaced(node, value=new)


def other_functions(node):
    """Yield a call of another function."""
    field = {ast.Name: "id", ast.Attribute: "attr"}.get(type(node.func))
    name = getattr(node.func, field) if field else ""
    if name in FUNCTIONS:
        func = replaced(node.func, **{field: FUNCTIONS[name]})
        yield f"{name} to {FUNCTIONS[name]}", replaced(node, func=func)


def mutants_of(root, file):
    """Yield all mutants of a file below a root."""
    tree = ast.parse((root / file).read_bytes())
    reals = reals_of(tree)
    for number, node in enumerate(nodes_of(tree)):
        for choice, (text, _) in enumerate(mutations(node, reals)):
            yield Mutant(file, node.lineno, number, choice, text)


def mutated(source, number, choice):
    """Return the syntax tree of a source text with one node replaced."""
    tree = ast.parse(source)
    target = nodes_of(tree)[number]
    _, new = list(mutations(target, reals_of(tree)))[choice]
    ast.copy_location(new, target)

    class Replacer(ast.NodeTransformer):
        def visit(self, node):
            return new if node is target else self.generic_visit(node)

    return ast.fix_missing_locations(Replacer().visit(tree))
