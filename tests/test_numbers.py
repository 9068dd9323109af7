"""Every number of the README and the pages has an account that holds; and the check itself can fail."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dashpot.studies import numbers
from dashpot.studies.numbers import DOCS, LEDGERS, ROOT, account_of, holds, pages, same_line, unit_of

numerals = st.from_regex(r"\A-?[1-9][0-9]{0,4}(\.[0-9]{1,4})?(e-?[1-9])?\Z")


@pytest.mark.parametrize("page", pages(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_every_number_is_accounted_for(page):
    account = account_of(page)
    assert [*account.wrong, *account.missing()] == []


def test_every_account_has_its_page_and_every_evidence_its_reader():
    names = {p.relative_to(DOCS if p.is_relative_to(DOCS) else ROOT).with_suffix(".toml") for p in pages()}
    ledgers = sorted(LEDGERS.rglob("*.toml"))
    assert {p.relative_to(LEDGERS) for p in ledgers} <= names
    read = "\n".join(p.read_text("utf-8") for p in ledgers)
    assert [p.name for p in (DOCS / "evidence").glob("*.json") if f'"{p.name}"' not in read] == []


@given(numerals)
def test_a_number_is_itself_and_not_its_neighbour(quoted):
    value, unit = float(quoted), unit_of(quoted)
    assert holds(quoted, value)
    assert holds(quoted, value + 0.49 * unit)
    assert not holds(quoted, value + 0.51 * unit)
    assert not holds(quoted, value - 0.51 * unit)


@given(numerals, st.floats(0.01, 50))
def test_a_stated_tolerance_is_kept(quoted, percent):
    value = float(quoted)
    assert holds(quoted, value / (1 + 0.99 * percent / 100), f"{percent} %")
    assert not holds(quoted, value / (1 + 1.01 * percent / 100), f"{percent} %")


@given(numerals)
def test_lines_agree_to_a_unit_of_the_last_digit(quoted):
    assert same_line(f"| a |  {quoted} N m |", f"| a | {quoted} N m |")
    assert not same_line(f"| a | {quoted} N m |", f"| b | {quoted} N m |")
    assert not same_line(f"| a | {quoted} N m |", f"| a | {quoted[::-1]}7 s |")


def test_words_are_numbers_and_answers_are_words():
    assert holds("none", 0)
    assert holds("4,274", 4274)
    assert holds("yes", "yes")
    assert not holds("yes", "no")
    assert holds("no", "no")
    assert not holds("no", "yes")
    assert not holds("1", True)


@pytest.fixture
def page(tmp_path, monkeypatch):
    monkeypatch.setattr(numbers, "DOCS", tmp_path)
    monkeypatch.setattr(numbers, "LEDGERS", tmp_path / "numbers")
    (tmp_path / "numbers").mkdir()
    (tmp_path / "evidence").mkdir()
    (tmp_path / "evidence" / "a.json").write_text('{"drives": {"of": 200, "covered": 0.9777}}')

    def write(text: str, ledger: str) -> list[str]:
        (tmp_path / "x.md").write_text(text)
        (tmp_path / "numbers" / "x.toml").write_text(ledger)
        account = account_of(Path(tmp_path / "x.md"))
        return [*account.wrong, *account.missing()]

    return write


QUOTE = """
given = ["within 3 s"]
[[from]]
evidence = "a.json"
quotes = ["of [200 = drives.of] drives [97.8 = 100 * drives.covered] %"]
"""


def test_an_account_that_holds(page):
    text = "1. of 200\ndrives 97.8 % within 3 s: of 200 drives 97.8 %. `-n 7`, Fig. 5 (1997), eq. `x = 2`"
    assert page(text, QUOTE) == []


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("of 200 drives 97.9 % within 3 s", "of 200 drives 97.8 %.*not in the page"),
        ("of 200 drives 97.8 % within 3 s, and 4 more", "4 in .*no account"),
        ("of 200 drives 97.8 %", "given .*within 3 s.*not in the page"),
        ("of 200 drives 97.8 % within 3 s\n\n```\nit took 12 ms\n```\n", "12 in .*no account"),
    ],
)
def test_what_an_account_does_not_cover_is_said(page, text, says):
    assert any(re.search(says, line) for line in page(text, QUOTE))


@pytest.mark.parametrize(
    ("ledger", "says"),
    [
        (
            '[[from]]\nevidence = "a.json"\nquotes = ["of [201 = drives.of]"]',
            "201 said, 200 found: drives.of",
        ),
        (
            '[[from]]\nevidence = "a.json"\nquotes = ["of [201 = drives.all]"]',
            "no 'all'; there are of, covered",
        ),
        ('[[from]]\nquotes = ["of 201"]', r"nothing like \[number = expression\]"),
        ('[[from]]\nqoutes = ["of 201"]', "qoutes: unknown key"),
        ("[session]\nskip = []", "does not print: of 201"),
    ],
)
def test_what_does_not_hold_is_said(page, ledger, says):
    found = page("of 201\n\n```\n$ echo of 207\nof 201\n```\n", ledger)
    assert any(re.search(says, line) for line in found), found


def test_a_session_goes_through_a_page(page):
    first = "```\n$ echo 2 > a; \\\n  echo 31 > b\n```\n"
    text = first + "```\n$ cat b a\n...\n2\n$ echo took 7 ms\ntook 9 ms\n```\n"
    assert page(text, '[session]\nloose = ["took"]') == []
    assert page(text, "[session]") != []
