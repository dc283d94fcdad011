"""Draw random samples of the prose of this project, to be graded by a reader who did not write it.

    python tests/readability/draw.py --seed 20261128 > tests/readability/sample.tsv

Each row has the kind, the place and the text. Commit the sample before it is graded, so that no text is improved for
the grade. A reader marks a row as good if its meaning is clear at first sight. The result replaces the sample: the
files `*_grades.tsv` have the same rows with the verdict, and a better version of each bad text.

`lost_facts.tsv` gives the reason for each number and code span that the rewriting removed or changed.
`remaining_hits.tsv` gives the reason for 40 places, drawn with seed 20261201, that a counter of patterns still reports.
"""

from __future__ import annotations

import argparse
import ast
import io
import random
import re
import subprocess
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: How many rows of each kind are drawn.
COUNTS = {"page": 150, "docstring or comment": 150, "error": 60, "test": 100}
#: A sentence ends with one of these characters before a space and a capital letter.
_SENTENCE = re.compile(r"(?<=[.!?])\s+(?=[A-Z`*\[])")
Row = tuple[str, str, str]


def tracked(*patterns: str) -> list[Path]:
    """Return the files of the repository that match."""
    names = subprocess.run(["git", "ls-files", *patterns], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in names.splitlines() if not name.startswith("docs/tables/")]


def sentences(text: str, least: int = 4) -> Iterator[str]:
    """Yield the sentences of a paragraph that have at least `least` words."""
    for sentence in _SENTENCE.split(" ".join(text.split())):
        if len(sentence.split()) >= least:
            yield sentence


def pages() -> Iterator[Row]:
    """Yield the sentences of README, CONTRIBUTING and the pages, without code, tables and directives."""
    for path in tracked("README.md", "CONTRIBUTING.md", "docs/*.md", "packages/*/README.md"):
        text = re.sub(r"^(`{3,}|:{3,}).*?^\1", "\n", path.read_text(), flags=re.M | re.S)
        for paragraph in re.split(r"\n\s*\n|\n(?=\s*[-*\d]+[.]? )", text):
            if not re.match(r"\s*([|#<!:(]|\[.*\]: )", paragraph):
                for sentence in sentences(re.sub(r"^\s*([-*]|\d+\.) ", "", paragraph)):
                    yield "page", str(path.relative_to(ROOT)), sentence


def python(path: Path) -> Iterator[Row]:
    """Yield the docstrings, comments, error messages and test names of a module."""
    place, source = str(path.relative_to(ROOT)), path.read_text()
    is_test = "tests" in path.relative_to(ROOT).parts
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            for paragraph in re.split(r"\n\s*\n|::\n.*|\n\s+(?=\w+: )", ast.get_docstring(node) or ""):
                if not paragraph.lstrip().startswith(">>>"):
                    for sentence in sentences(paragraph):
                        yield "docstring or comment", f"{place}:{getattr(node, 'lineno', 1)}", sentence
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and node.name.startswith("test_"):
            yield "test", f"{place}:{node.lineno}", node.name
        if not is_test and isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and node.exc.args:
            text = ast.unparse(node.exc.args[0])
            if isinstance(node.exc.args[0], (ast.JoinedStr, ast.Constant)) and len(text.split()) >= 4:
                yield "error", f"{place}:{node.lineno}", text
    block: list[str] = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            block.append(token.string.lstrip("#: "))
        elif token.type not in (tokenize.NL, tokenize.INDENT, tokenize.DEDENT) and block:
            for sentence in sentences(" ".join(block)):
                yield "docstring or comment", f"{place}:{token.start[0]}", sentence
            block = []


def main() -> None:
    parser = argparse.ArgumentParser(description="draw samples of the prose of this project")
    parser.add_argument("--seed", type=int, required=True, help="seed of the draw")
    seed = parser.parse_args().seed
    rows = [*pages(), *(row for path in tracked("src/*.py", "packages/*.py", "tests/*.py") for row in python(path))]
    for kind, count in COUNTS.items():
        among = sorted({row for row in rows if row[0] == kind})
        for row in random.Random(f"{seed} {kind}").sample(among, count):
            print("\t".join(row))


if __name__ == "__main__":
    main()
