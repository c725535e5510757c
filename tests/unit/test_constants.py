"""Every number with a name says what it is, its unit, and where it comes from; tested is only that there is a text."""

import ast
import io
import re
import tokenize
from itertools import pairwise
from pathlib import Path

import pytest

SRC = Path(__file__).resolve().parents[2] / "src"
NAME = re.compile(r"_?[A-Z][A-Z0-9_]*")
NO_REASON = re.compile(r"#\s*(fmt|noqa|type)\b")
ARITHMETIC = {"math", "np.radians", "np.deg2rad"}
"""Calls that only convert the numbers in them; those of all other calls are arguments, and not looked at."""


def named(statement):
    """Return whether a statement gives a value to one or several names of constants."""
    if isinstance(statement, ast.Assign):
        targets = statement.targets
    elif isinstance(statement, ast.AnnAssign):
        targets = [statement.target]
    else:
        return False
    names = [name for target in targets for name in (target.elts if isinstance(target, ast.Tuple) else [target])]
    return all(isinstance(name, ast.Name) and NAME.fullmatch(name.id) for name in names)


def numbers(value):
    """Yield the number literals of a value."""
    if isinstance(value, ast.Constant) and type(value.value) in (int, float):
        yield value.value
    elif isinstance(value, ast.Call):
        function = ast.unparse(value.func)
        if function in ARITHMETIC or function.partition(".")[0] in ARITHMETIC:
            for argument in value.args:
                yield from numbers(argument)
    elif not isinstance(value, ast.JoinedStr | ast.Lambda):
        for part in ast.iter_child_nodes(value):
            yield from numbers(part)


def commented(source):
    """Return the lines that end in a comment, other than one for a tool."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return {token.start[0] for token in tokens if token.type == tokenize.COMMENT and not NO_REASON.match(token.string)}


def documented(run):
    """Return whether a docstring stands directly below assignments on consecutive lines, with which a body begins."""
    for above, below in pairwise(run):
        if below.lineno != above.end_lineno + 1:
            return False
        if not isinstance(below, ast.Assign | ast.AnnAssign):
            text = below.value if isinstance(below, ast.Expr) else None
            return isinstance(text, ast.Constant) and isinstance(text.value, str)
    return False


def unexplained(source):
    """Return the lines of constants without an explanation: no comment on the last line, no docstring below the run."""
    body, comments, lines = ast.parse(source).body, commented(source), []
    for at, statement in enumerate(body):
        if not named(statement) or statement.value is None or {abs(x) for x in numbers(statement.value)} <= {0, 1}:
            continue
        if statement.end_lineno not in comments and not documented(body[at:]):
            lines.append(statement.lineno)
    return lines


def test_every_constant_says_what_it_is_and_where_it_comes_from():
    found = []
    for file in sorted((SRC / "kreisel").rglob("*.py")):
        source = file.read_text(encoding="utf-8")
        texts = source.splitlines()
        found += [f"{file.relative_to(SRC.parent)}:{line}: {texts[line - 1]}" for line in unexplained(source)]
    advice = "say what they are, their unit, and where the number comes from, or what it was chosen between"
    assert not found, f"{len(found)} constants without a docstring or a comment; {advice}:\n" + "\n".join(found)


@pytest.mark.parametrize(
    "source",
    [
        "_A = 2.5\n",
        "A: float = -3\n",
        "A, B = 2, 3\n",
        "A = {'x': (0, 1, 2)}\n",
        "A = 1 << 20  # noqa: X100\n",
        "A = (\n    2,  # of the first\n    3,\n)\n",
        "A = math.sqrt(2.0)\n",
        'A = 2.5\n\n"""Not directly below."""\n',
        'A = 2.5\n\nB = 3.5\n"""Of B alone."""\n',
        "A = 2.5\nf(3)\n",
        "A = 2.5; B = '#'\n",
    ],
)
def test_a_constant_without_explanation_is_found(source):
    assert unexplained(source) == [1]


@pytest.mark.parametrize(
    "source",
    [
        'A = 2.5\n"""m; chosen."""\n',
        'A = 2.5\nB = re.compile("x")\nC, D = 3, 4\n"""m; chosen."""\n',
        "A = 2.5  # m; chosen\nB = 1\n",
        "A = (\n    2,\n    3,\n)  # m; chosen\n",
        "A, B, C = 0, 1, -1.0\n",
        "A = re.compile('x', 2)\n",
        "A = np.array([2.5])\n",
        "A = f'{100 * B} %'\n",
        "A = True\n",
        "A: float\n",
        "a = 2.5\n",
        "def f():\n    A = 2.5\n",
    ],
)
def test_what_has_an_explanation_or_needs_none_is_not_found(source):
    assert unexplained(source) == []
