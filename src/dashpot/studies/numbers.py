"""Where every number of the README and of the pages comes from, and whether it still holds.

``python -m dashpot.studies.numbers [PAGE ...]`` says what does not, and which numbers nothing accounts for.
docs/numbers/PAGE.toml is a page's account::

    given = ["up to 16 drives"]           # quoted from the page: inputs, definitions, what others measured

    [[from]]
    evidence = "certify.json"             # of docs/evidence; its keys are names
    quotes = ["one of [4,274 = soundness.certified] certified random joints"]

    [[from]]
    python = "from dashpot.simulation.faults import KINDS"
    quotes = ["[16 = len(KINDS)] kinds of faults"]

    [[from]]
    run = "python -m dashpot.studies.laws"  # prints lines that the page shows
    lines = "out"

    [session]                             # the page's ``$`` lines, typed one after the other in one folder
    before = ["cp $ROOT/examples/own_* ."]

A quoted number may differ from its source by half a unit of its last digit, or by what is stated:
``[16 = fr3.times ± 10 %]``. Where text is compared line by line, numbers may differ by a unit of their last
digit, or by ``tolerance``, a share.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any

from dashpot.studies.numbers_run import Session, printed

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
LEDGERS = DOCS / "numbers"
NUMBER = r"(?:(?<![\w.,^-])[-−+]?|(?<=\W)[-−+])\d[\d,]*(?<!,)(?:\.\d+)?(?:e[-+]?\d+)?"
WORDS = {"none": 0, "no": 0, "one": 1, "two": 2, "three": 3, "four": 4, "five": 5, "six": 6, "seven": 7}
WORDS |= {"eight": 8, "nine": 9, "ten": 10, "eleven": 11, "twelve": 12, "fourteen": 14, "sixteen": 16}
FENCE = re.compile(r"^(`{3,})(\w*)[^\n]*\n(.*?)^\1 *$", re.M | re.S)
NO_FIGURES = re.compile(  # numbers there are names, inputs or another's
    "|".join(
        (
            r"<!--.*?-->",
            r"^ *\d+\. ",  # items of a list
            r"^#+ [^\n]*$",
            r"\]\([^)\s]*\)",
            r"(?<!`)``?[^`\n]+`",
            r"\bEqs?\. \([A\d]+\)(?:[-–]\([A\d]+\))?(?:(?:, | and )\([A\d]+\))*",
            r"\([A]?\d{1,2}\)(?:/\([A]?\d{1,2}\))?",  # equations
            r" \[\d{1,2}\](?!\()",  # sources
            r"\bFigs?\. \d+(?: \([ab]\))?(?:(?:, | and | to )\d+)*",
            r"\b(?:1[89]|20)\d\d\b(?=[,;).]| ?\()|(?<=, )(?:19|20)\d\d\b",  # years
            r"\bTM-\d+|\bPython (?:below )?3\.\d+\+?|\bISO [\d-]+|\b1/s\b",
            r"\b[Jj]oints? \d(?:(?:, | and | or | to )\d)*\b",
        )
    ),
    re.M | re.S,
)


class Keys(dict[str, Any]):
    """A JSON object whose keys are attributes, too."""

    def __getattr__(self, key: str) -> Any:
        try:
            return self[key]
        except KeyError:
            raise AttributeError(f"no {key!r}; there are {', '.join(self)}") from None


@dataclass
class Account:
    """What was found of one page: the places of numbers that are accounted for, and what is wrong."""

    text: str
    places: list[tuple[int, int]] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)

    def missing(self) -> Iterator[str]:
        """Every number outside programs that nothing accounts for, with its surroundings."""
        text = NO_FIGURES.sub(_blank, FENCE.sub(_blank_inputs, self.text))
        for number in re.finditer(NUMBER, text):
            if not any(a <= number.start() and number.end() <= b for a, b in self.places):
                line = 1 + self.text.count("\n", 0, number.start())
                around = self.text[max(0, number.start() - 30) : number.end() + 30].replace("\n", " ")
                yield f"line {line}: {number[0]} in “{around}”: no account"


def _blank(match: re.Match[str]) -> str:
    return re.sub(r"\S", " ", match[0])


def _blank_inputs(match: re.Match[str]) -> str:
    """Programs and files are inputs, and so are typed lines; the rest of a block is what a command prints."""
    if match[2] not in ("", "console", "text"):
        return _blank(match)
    typing = re.compile(
        r"^(?:\$ |(?:dashpot|make|python|pip|cp|sed|cc|cd|mkdir|git|sudo|export|pytest)\b)(?:.*\\\n)*.*$"
        r"|^#.*$|(?<=\S)  +# .*$",
        re.M,
    )
    return typing.sub(_blank, match[0])


def value_of(quoted: str) -> float | str:
    """A number as a page writes it, with commas for thousands or as a word; any other word is itself."""
    try:
        return float(Decimal(quoted.replace(",", "").replace("−", "-")))
    except ArithmeticError:
        return WORDS.get(quoted.lower(), quoted)


def unit_of(quoted: str) -> float:
    """One in the last digit of a number as it is written: 0.01 of 3.14."""
    try:
        return float(
            Decimal(1).scaleb(int(Decimal(quoted.replace(",", "").replace("−", "-")).as_tuple().exponent))
        )
    except ArithmeticError:
        return 0.0


def holds(quoted: str, value: Any, tolerance: str | None = None) -> bool:
    """Whether a number as a page writes it is a value: rounded, or within ``3``, or within ``10 %``."""
    said = value_of(quoted)
    if isinstance(said, str) or isinstance(value, str | bool):
        return quoted == str(value)
    if tolerance is None:
        allowed = unit_of(quoted) / 2
    elif tolerance.endswith("%"):
        allowed = float(tolerance[:-1]) / 100 * abs(value)
    else:
        allowed = float(tolerance)
    return bool(abs(said - value) <= allowed * (1 + 1e-9) + 1e-12 * abs(value))


def same_line(shown: str, line: str, tolerance: float = 0.0) -> bool:
    """Whether two lines agree but for spaces, rules and the last digits of numbers."""

    def parts(text: str) -> tuple[list[str], list[str]]:
        text = re.sub(r"[─]+", "─", re.sub(r"\s+", " ", text.strip()))
        return re.split(NUMBER, text), re.findall(NUMBER, text)

    (words, said), (others, found) = parts(shown), parts(line)
    if words != others:
        return False
    for a, b in zip(said, found, strict=True):
        x, y = value_of(a), value_of(b)
        assert not isinstance(x, str)
        assert not isinstance(y, str)
        if abs(x - y) > max(unit_of(a), unit_of(b), tolerance * abs(y)) * (1 + 1e-9):
            return False
    return True


def _pattern(fragment: str) -> str:
    """A fragment as it may be broken over lines."""
    start = r"(?<![\w.])" if re.match(r"\w", fragment) else ""
    return start + r"\s+".join(re.escape(word) for word in fragment.split())


QUOTED = re.compile(r"\[([^\[\]=]+?) = ((?:[^\[\]]|\[[^\[\]]*\])+)\]")


def _quote(account: Account, fragment: str, evaluate: Callable[[str], Any]) -> None:
    """Checks ``words [number = expression] words`` against the page and its source."""
    claims: list[tuple[str, str]] = []
    bare, joint = fragment, "\x00{}\x00"
    for match in QUOTED.finditer(fragment):
        bare = bare.replace(match[0], joint.format(len(claims)), 1)
        claims.append((match[1].strip(), match[2]))
    if not claims:
        account.wrong.append(f"“{fragment}”: nothing like [number = expression] in it")
        return
    pattern = _pattern(bare)
    for i, (quoted, _) in enumerate(claims):
        pattern = pattern.replace(re.escape(joint.format(i)), f"({re.escape(quoted)})")
    found = list(re.finditer(pattern + r"(?!\d)", account.text))
    if not found:
        plain = QUOTED.sub(lambda m: m[1], fragment)
        account.wrong.append(f"“{plain}”: not in the page")
    for match in found:
        account.places += [match.span(1 + i) for i in range(len(claims))]
    position = len(account.wrong)
    for quoted, expression in claims:
        expression, _, tolerance = (part.strip() for part in expression.partition("±"))
        try:
            value = evaluate(expression)
        except Exception as error:  # of whatever an account says
            account.wrong.insert(position, f"{expression}: {type(error).__name__}: {error}")
            continue
        if not holds(quoted, value, tolerance or None):
            account.wrong.insert(position, f"{quoted} said, {value} found: {expression}")


def _lines(account: Account, lines: list[str], tolerance: float, what: str) -> None:
    """Checks that the page shows these lines in this order, whatever stands between them."""
    shown = account.text.split("\n")
    starts, next_line = [0], 0
    for line in shown:
        starts.append(starts[-1] + len(line) + 1)
    for line in filter(str.strip, lines):
        equal = (i for i in range(next_line, len(shown)) if same_line(shown[i], line, tolerance))
        at = next(equal, None)
        if at is None:
            account.wrong.append(f"{what}: not in the page, or not in this order: {line.strip()}")
            continue
        next_line = at + 1
        account.places.append((starts[at], starts[next_line]))


def _names(source: dict[str, Any]) -> dict[str, Any]:
    """What the expressions of one source may name."""
    files = source.get("evidence", [])
    files = [files] if isinstance(files, str) else files
    names: dict[str, Any] = {}
    for name in files:
        read = json.loads((DOCS / "evidence" / name).read_text("utf-8"), object_hook=Keys)
        names[Path(name).stem.replace("-", "_")] = read
        if len(files) == 1:
            names |= read
    if "python" in source:
        exec(source["python"], names)
    if "run" in source:
        names["out"] = printed(source["run"], ROOT)
    return names


def account_of(page: Path) -> Account:
    """Everything that docs/numbers says of a page, checked.

    Raises:
        FileNotFoundError: there is no such page; a page without an account has an empty one.
    """
    account = Account(page.read_text("utf-8"))
    ledger = LEDGERS / page.relative_to(DOCS if page.is_relative_to(DOCS) else ROOT).with_suffix(".toml")
    said = tomllib.loads(ledger.read_text("utf-8")) if ledger.exists() else {}
    for key in said.keys() - {"given", "from", "session"}:
        account.wrong.append(f"{ledger.name}: {key}: unknown key; given, [[from]] and [session] there are")
    for fragment in said.get("given", []):
        found = list(re.finditer(_pattern(fragment), account.text))
        if not found or not re.search(NUMBER, fragment):
            account.wrong.append(f"given “{fragment}”: {'no number in it' if found else 'not in the page'}")
        account.places += [match.span() for match in found]
    for source in said.get("from", []):
        for key in source.keys() - {"evidence", "python", "run", "quotes", "lines", "tolerance"}:
            account.wrong.append(f"{ledger.name}: [[from]] {key}: unknown key")
        names = _names(source)
        for fragment in source.get("quotes", []):
            _quote(account, fragment, lambda text, names=names: eval(text, names))  # type: ignore[misc]
        if "lines" in source:
            lines = eval(source["lines"], names)
            lines = lines.splitlines() if isinstance(lines, str) else list(lines)
            _lines(account, lines, source.get("tolerance", 0.0), source["lines"])
    if "session" in said:
        session = Session(said["session"], account.text, ROOT, same_line).run()
        account.places += session.places
        account.wrong += session.wrong
    return account


def pages() -> list[Path]:
    """The README and every page but the record of decisions, which says what was known then."""
    return [ROOT / "README.md", *sorted(set(DOCS.rglob("*.md")) - {DOCS / "decisions.md"})]


def main(arguments: list[str]) -> int:
    """Prints what is wrong and what is missing; 1 if anything is."""
    chosen = [page for page in pages() if not arguments or page.stem in arguments]
    bad = 0
    for page in chosen:
        account = account_of(page)
        said = [*account.wrong, *account.missing()]
        bad += len(said)
        print(f"{page.relative_to(ROOT)}: {len(said) or 'every number accounted for'}")
        for line in said:
            print(f"  {line}")
    return bad > 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
