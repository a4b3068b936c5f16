"""Check the language of pages, docstrings and help texts.

``python docs/check_language.py [--count | --pending | FILE...]`` prints one line for each finding,
``file:line: rule: text``, and ends with status 1 if there is any. The rules:

- ``long``: a sentence of more than 40 words. A sentence ends at ``.``, ``!`` or ``?``, and at the end of a paragraph,
  a list item, a table cell or a heading. Colons and semicolons do not end it. An inline code span or a formula is one
  word; of a link the text counts.
- ``opening``: a sentence or heading that begins with a relative clause (What, Who, Where ...) and is no question.
- ``history``: words that tell how the software was, outside the changelog and ``docs/log``.
- ``subject``: a commit subject of more than 72 characters, of the commits since :data:`SUBJECTS_SINCE`.
- ``budget``: a page with more words than :data:`BUDGETS` allows: all that stands between spaces or table lines and
  holds a letter or a digit, code included.

Code blocks, displayed equations, doctests, front matter and comments hold no sentences. Generated pages
(:data:`UNJUDGED`) are left out. :data:`EXCEPTIONS` and :data:`PENDING` name the files that a rule does not judge;
an exception that excuses nothing is a finding itself.
"""

from __future__ import annotations

import argparse
import ast
import itertools
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

MOST_WORDS = 40
"""Words of the longest sentence."""
MOST_CHARACTERS = 72
"""Characters of the longest commit subject."""
SUBJECTS_SINCE = "24c06bdd2ef5277936f08f88c1719a3313c88da6"
"""The commit after which subjects are checked."""

BUDGETS: tuple[tuple[str, int], ...] = (
    ("README.md", 600),
    ("CHANGELOG.md", 1500),
    ("docs/start.md", 500),
    ("docs/learn/*.py", 500),
    ("docs/how-to/*.md", 500),
    ("docs/reference/*.md", 2500),
    ("docs/explanation/*.md", 2500),
    ("docs/accuracy.md", 1500),
    ("docs/glossary.md", 400),
)
"""Most words a page; of a lesson, the words of its text."""
TOTALS: tuple[tuple[str, tuple[str, ...], int], ...] = (
    ("docs/log", (), 25_000),
    ("docs", ("docs/log/*", "docs/thesis/*", "docs/api/*"), 50_000),
)
"""Most words of all pages in a folder, but for those of some patterns."""

UNJUDGED = ("docs/api/*", "docs/thesis/thesis.md", "docs/learn/.ipynb_checkpoints/*")
"""Generated files."""
HISTORIES = ("docs/log/*", "CHANGELOG.md")
"""Files that tell what was."""

EXCEPTIONS: tuple[tuple[str, str, str], ...] = ()
"""File, rule and the reason why the rule does not hold there."""

PENDING: tuple[str, ...] = ()
"""Files not yet rewritten (patterns; ``docs`` is the sum of its pages): no rule judges them."""

_RELATIVE = re.compile(r"(What|Who|Whose|Whom|Where|Which|Whoever|Whomever|Whatever|Wherever|Whichever)\b(?!')")
_HISTORY = re.compile(
    r"\((?:before|was|were|formerly),? [+-]?\d"  # "(was 12.9 %)"
    r"|\b(?:was|were) (?:about )?[+-]?\d"
    r"|\d(?: %)?,? before\)"
    r"|\b(?:until|up to) now\b|\bnow also\b|\b(?:is|are) now [+-]?\d|\bas (?:it|they) (?:is|are|stands?) now\b"
    r"|\bused to (?:be|have)\b|\b(?:it|they|this|that|which|there) used to\b"
    r"|\bno longer (?:needed|supported|used|required|necessary|available|part)\b"
    r"|\b(?:formerly|(?:earlier|older) versions? of mufly)\b"
    r"|\bseeds? [1-9]\d{2,}\b",
    re.IGNORECASE,
)
_ABBREVIATION = re.compile(
    r"(?:e\.g|i\.e|cf|vs|etc|al|eqs?|figs?|sec|nos?|pp?|vol|ch|approx|refs?|tab|resp|ca)\.", re.IGNORECASE
)
_END = re.compile(r"[.!?][\"')\]*_”’]*(?=\s|$)")
_ITEM = re.compile(r"(?:[-*+]|\d+[.)])\s+")
_TABLE_BORDER = re.compile(r"=+(?: +=+)+")
_FENCE = re.compile(r"(`{3,}|~{3,}|:{3,})\s*(\{[\w:-]+\})?\s*(.*)")
_PROSE_DIRECTIVES = frozenset(("{note}", "{warning}", "{tip}", "{important}", "{caution}", "{admonition}", "{seealso}"))


@dataclass(frozen=True)
class Block:
    """A paragraph, heading, list item or table cell: text without sentences of others.

    Attributes
    ----------
    line : int
        Its first line in the file, from 1.
    kind : str
        ``"paragraph"``, ``"heading"``, ``"item"`` or ``"cell"``.
    text : str
        Its lines, joined by spaces.
    """

    line: int
    kind: str
    text: str


@dataclass(frozen=True)
class Finding:
    """One breach of a rule; printed as ``file:line: rule: text``."""

    file: str
    line: int
    rule: str
    text: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.rule}: {self.text}"


def markdown_blocks(text: str, first: int = 1) -> list[Block]:
    """Split a Markdown page into its blocks of prose.

    Parameters
    ----------
    text : str
        The page.
    first : int
        The number of its first line.

    Returns
    -------
    list of Block
        In the page's order; code, displayed equations, directives' options, comments and pictures left out.
    """
    text = re.sub(r"<!--.*?-->", lambda m: re.sub(r"[^\n]", "", m[0]), text, flags=re.DOTALL)
    lines = text.splitlines()
    blocks: list[Block] = []
    gathered: list[str] = []
    kind, start = "paragraph", first
    inside_item = False

    def flush() -> None:
        nonlocal gathered
        if gathered:
            blocks.append(Block(start, kind, " ".join(gathered)))
        gathered = []

    at = 0
    if lines and lines[0].strip() == "---":  # front matter
        end = next((i for i, line in enumerate(lines[1:], 1) if line.strip() == "---"), None)
        at = 0 if end is None else end + 1
    while at < len(lines):
        raw, line = lines[at], lines[at].strip()
        number = first + at
        at += 1
        fence = _FENCE.match(line)
        if fence:
            flush()
            if fence[1][0] == ":" and not fence[2]:
                continue  # the end of a directive of colons
            if fence[2] in _PROSE_DIRECTIVES:
                if fence[3]:
                    blocks.append(Block(number, "heading", fence[3]))
                continue
            if fence[1][0] in "`~" and not fence[2] and not fence[3] and _open_directive(lines[: at - 1], fence[1]):
                continue  # the end of a directive with prose
            while at < len(lines) and lines[at].strip() != fence[1]:
                at += 1
            at += 1
        elif line.startswith("$$"):
            flush()
            if not (len(line) > 2 and line.endswith("$$")):
                while at < len(lines) and not lines[at].strip().endswith("$$"):
                    at += 1
                at += 1
        elif not line:
            flush()
            kind = "paragraph"
        elif raw.startswith("    ") and not gathered and not inside_item:
            continue  # an indented block of code
        elif re.match(r"#{1,6}\s", line):
            flush()
            inside_item = False
            blocks.append(Block(number, "heading", line.lstrip("#").strip()))
        elif line.startswith("|"):
            flush()
            if not re.fullmatch(r"[|:\-\s]+", line):
                cells = re.split(r"(?<!\\)\|", line.strip("|"))
                blocks += [Block(number, "cell", c.strip()) for c in cells if c.strip()]
        else:
            item = _ITEM.match(line)
            if item or not gathered:
                flush()
                kind, start = ("item" if item else "paragraph"), number
                inside_item = bool(item) or (inside_item and raw[0] == " ")
            gathered.append(line[item.end() :] if item else line.lstrip("> "))
    flush()
    return [b for b in blocks if plain_text(b.text)]


def _open_directive(lines: list[str], fence: str) -> bool:
    """Whether a directive with prose is open before this fence."""
    opened = False
    for line in lines:
        found = _FENCE.match(line.strip())
        if found and found[1] == fence:
            opened = found[2] in _PROSE_DIRECTIVES
    return opened


def docstring_blocks(text: str, first: int) -> list[Block]:
    """Split a NumPy-style docstring into its blocks; a change of indentation begins a new one.

    Each cell of a simple table of reStructuredText, between borders of ``=``, is a block. A row whose first cell is
    empty continues the row above.

    Parameters
    ----------
    text : str
        The docstring as it stands in the source, indentation included.
    first : int
        The number of its first line.
    """
    blocks: list[Block] = []
    gathered: list[str] = []
    start, depth, code_depth = first, 0, None
    lines = text.splitlines()
    margin = min((len(x) - len(x.lstrip()) for x in lines[1:] if x.strip()), default=0)
    kind = "paragraph"
    columns: list[int] = []  # where the columns of an open table begin
    cells: list[str] = []
    borders = [i for i, x in enumerate(lines) if _TABLE_BORDER.fullmatch(x.strip())]

    def flush() -> None:
        nonlocal gathered, cells
        if gathered:
            blocks.append(Block(start, kind, " ".join(gathered)))
        blocks.extend(Block(start, "cell", cell) for cell in cells)
        gathered, cells = [], []

    for i, raw in enumerate(lines):
        line = raw.strip()
        if i in borders:
            flush()
            follows = [k for k in borders if k > i]
            is_open = bool(follows) and all(x.strip() for x in lines[i : follows[0]])
            columns = [m.start() for m in re.finditer("=+", raw)] if is_open else []
            continue
        if columns:
            row = [raw[a:b].strip() for a, b in itertools.zip_longest(columns, columns[1:])]
            if row[0] or not cells:
                flush()
                start, cells = first + i, row
            else:
                cells = [f"{old} {new}".strip() for old, new in zip(cells, row, strict=True)]
            continue
        indent = 0 if i == 0 else len(raw) - len(raw.lstrip()) - margin
        if not line:
            flush()
            continue
        if code_depth is not None:
            if indent > code_depth:
                continue
            code_depth = None
        if re.fullmatch(r"[-=~]{3,}", line):  # the line below a section's name
            gathered = []
        elif re.match(r"[=+]{2,}[\s=+-]*$|\|", line) or line.startswith(">>>"):
            flush()
        elif line.startswith(".. "):
            flush()
            code_depth = indent
        else:
            item = _ITEM.match(line)
            if item or not gathered or (indent != depth and kind != "item"):
                flush()
                start, depth, kind = first + i, indent, "item" if item else "paragraph"
            elif indent < depth:
                flush()
                start, depth, kind = first + i, indent, "paragraph"
            gathered.append(line[item.end() :] if item else line)
            if line.endswith("::"):
                code_depth = indent
                flush()
    flush()
    return [b for b in blocks if plain_text(b.text)]


def plain_text(text: str) -> str:
    """Text as a reader sees it: a code span, a formula or a role is one word, a link is its text."""
    text = re.sub(r"!\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"(:[\w:+-]+:|\{[\w:+-]+\})?(`+)(?:(?!\2).)+?\2_?", "`code`", text)
    text = re.sub(r"\$[^$\s](?:[^$]*[^$\s])?\$", "`formula`", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return re.sub(r"\s+", " ", text.replace("**", "").replace("__", "")).strip()


def split_sentences(text: str) -> list[str]:
    """Sentences of one block, markup taken out."""
    plain = plain_text(text)
    sentences, begin = [], 0
    for end in _END.finditer(plain):
        words = plain[begin : end.end()].split()
        last = words[-1].lstrip("(\"'*_") if words else ""
        initial = re.fullmatch(r"[A-Z]\.", last) and not (len(words) > 1 and words[-2][-1].isdigit())  # "12 V." ends
        if initial or _ABBREVIATION.fullmatch(last):
            continue
        sentences.append(plain[begin : end.end()].strip())
        begin = end.end()
    sentences.append(plain[begin:].strip())
    return [s for s in sentences if s]


def count_words(sentence: str) -> int:
    """Words of a sentence: what stands between spaces and holds a letter or a digit."""
    return sum(any(c.isalnum() for c in word) for word in sentence.split())


def judge_block(block: Block, file: str) -> Iterator[Finding]:
    """Findings of the rules about sentences in one block."""
    for sentence in split_sentences(block.text):
        words = count_words(sentence)
        if words > MOST_WORDS:
            yield Finding(file, block.line, "long", f"{words} words: {shorten(sentence)}")
        opens = _RELATIVE.match(sentence.lstrip("\"'*_(“‘"))
        if opens and not sentence.rstrip("\"')*_”’").endswith("?") and (block.kind != "cell" or words > 4):
            yield Finding(file, block.line, "opening", shorten(sentence))
        if not matches(file, HISTORIES):
            for found in _HISTORY.finditer(sentence):
                yield Finding(file, block.line, "history", f"{found[0]!r} in: {shorten(sentence)}")


def shorten(text: str, most: int = 90) -> str:
    """The beginning of a text."""
    return text if len(text) <= most else text[: most - 3] + "..."


def matches(file: str, patterns: Iterable[str]) -> bool:
    """Whether a path fits one of the patterns."""
    return any(fnmatch(file, p) for p in patterns)


def lesson_cells(source: str) -> Iterator[tuple[int, str]]:
    """First line and text of each Markdown cell of a lesson (py:percent)."""
    start, lines = 0, None
    for number, line in enumerate([*source.splitlines(), "# %%"], 1):
        if line.startswith("# %%"):
            if lines:
                yield start, "\n".join(lines)
            start, lines = number + 1, ([] if "[markdown]" in line else None)
        elif lines is not None:
            lines.append(line.removeprefix("#").removeprefix(" "))


def source_texts(source: str) -> Iterator[tuple[int, str]]:
    """First line and text of each docstring and each help text of a module.

    Help texts are the arguments ``help`` of any call, and the second of ``define_option`` and ``define_argument``.
    A string behind an assignment documents a name, and counts as a docstring.
    """
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value
        elif isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            texts = [k.value for k in node.keywords if k.arg == "help"]
            texts += node.args[1:2] if name in ("define_option", "define_argument") else []
            for text in texts:
                if isinstance(text, ast.Constant) and isinstance(text.value, str):
                    yield text.lineno, text.value
                elif isinstance(text, ast.JoinedStr):
                    yield (
                        text.lineno,
                        "".join(str(v.value) if isinstance(v, ast.Constant) else "x" for v in text.values),
                    )


def file_blocks(path: Path) -> list[Block]:
    """Blocks of prose of a page, a lesson or a module."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return markdown_blocks(text)
    if path.parent.name == "learn":
        return [b for start, cell in lesson_cells(text) for b in markdown_blocks(cell, start)]
    return [b for start, doc in source_texts(text) for b in docstring_blocks(doc, start)]


def page_words(path: Path) -> int:
    """Words of a page, or of the text of a lesson; code counts, the lines of tables do not."""
    text = path.read_text(encoding="utf-8")
    page = text if path.suffix == ".md" else " ".join(cell for _, cell in lesson_cells(text))
    return count_words(page.replace("|", " "))


def all_files(root: Path) -> list[str]:
    """Paths, from the root, of all files that are judged."""
    paths = [root / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
    paths += [
        *(root / "docs").rglob("*.md"),
        *(root / "docs" / "learn").glob("*.py"),
        *(root / "src" / "mufly").rglob("*.py"),
    ]
    files = (p.relative_to(root).as_posix() for p in paths if p.exists())
    return sorted(f for f in files if not matches(f, UNJUDGED))


def budget_findings(root: Path, files: Iterable[str]) -> Iterator[Finding]:
    """Pages, and sums of pages, with more words than they may have."""
    words = {f: page_words(root / f) for f in files if not f.startswith("src/")}
    for file, count in words.items():
        most = next((n for pattern, n in BUDGETS if fnmatch(file, pattern)), None)
        if most is not None and count > most:
            yield Finding(file, 1, "budget", f"{count} words, {most} allowed")
    for folder, others, most in TOTALS:
        count = sum(n for f, n in words.items() if fnmatch(f, f"{folder}/*.md") and not matches(f, others))
        if count > most:
            yield Finding(folder, 1, "budget", f"{count} words in all, {most} allowed")


def subject_findings(root: Path) -> Iterator[Finding]:
    """Long subjects since :data:`SUBJECTS_SINCE`; none where the history is not there (a shallow clone, an archive)."""

    def git(*words: str) -> str | None:
        try:
            ran = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=False)
        except OSError:
            return None
        return ran.stdout if ran.returncode == 0 else None

    if git("merge-base", "--is-ancestor", SUBJECTS_SINCE, "HEAD") is None:
        return
    for line in (git("log", "--format=%h %s", f"{SUBJECTS_SINCE}..HEAD") or "").splitlines():
        commit, _, subject = line.partition(" ")
        if len(subject) > MOST_CHARACTERS:
            yield Finding(commit, 1, "subject", f"{len(subject)} characters: {subject}")


def check(root: Path = ROOT, *, pending: Iterable[str] = PENDING) -> list[Finding]:
    """All findings, but for those that are excepted or pending.

    Parameters
    ----------
    root : Path
        The repository.
    pending : iterable of str
        Patterns of files that are not judged.
    """
    files = all_files(root)
    found = [f for file in files for b in file_blocks(root / file) for f in judge_block(b, file)]
    found += [*budget_findings(root, files), *subject_findings(root)]
    excused = {(file, rule) for file, rule, _ in EXCEPTIONS}
    used = {(f.file, f.rule) for f in found}
    kept = [f for f in found if (f.file, f.rule) not in excused and not matches(f.file, pending)]
    return kept + [Finding(f, 1, "exception", f"excuses no finding of {rule!r}") for f, rule in sorted(excused - used)]


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Check the language of pages, docstrings and help texts.")
    parser.add_argument("files", nargs="*", help="Report these files only, pending or not.")
    parser.add_argument("--count", action="store_true", help="Print totals of each rule, pending files included.")
    parser.add_argument(
        "--pending", action="store_true", help="Print pending patterns with the number of their findings."
    )
    asked = parser.parse_args(words)
    everything = check(pending=()) if asked.files or asked.count or asked.pending else []
    if asked.pending:
        for pattern in PENDING:
            print(f"{sum(fnmatch(f.file, pattern) for f in everything):6d} {pattern}")
        return 0
    if asked.count:
        sentences = sum(len(split_sentences(b.text)) for f in all_files(ROOT) for b in file_blocks(ROOT / f))
        rules = Counter(f.rule for f in everything)
        for rule in ("long", "opening", "history", "subject", "budget", "exception"):
            share = (
                f", {100 * rules[rule] / sentences:.2f} % of {sentences} sentences"
                if rule in ("long", "opening")
                else ""
            )
            print(f"{rule}: {rules[rule]}{share}")
        return 0
    found = [f for f in everything if matches(f.file, asked.files)] if asked.files else check()
    for finding in found:
        print(finding)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
