"""Names name a thing: words that say a role in a sentence become fewer.

`tests/data/words.json` has how often each file uses a word of `shape.INSTEAD` as an identifier.
After a renaming, `python tests/test_words.py > tests/data/words.json` holds the new numbers.
"""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest
import shape

PACKAGE = Path(__file__).parent.parent / "weberwhisk"
TABLE = Path(__file__).parent / "data" / "words.json"


def counts(package: Path) -> dict[str, dict[str, int]]:
    """Uses of each word by file, where there are any."""
    files = {
        path.relative_to(package).as_posix(): dict(sorted(shape.identifiers(path).items()))
        for path in sorted(package.rglob("*.py"))
    }
    return {file: words for file, words in files.items() if words}


def added(now: dict[str, dict[str, int]], before: dict[str, dict[str, int]]) -> list[str]:
    """A sentence for each word that is used more often than before, with the files that do."""

    def total(files: dict[str, dict[str, int]]) -> Counter[str]:
        return sum(map(Counter, files.values()), Counter())

    sentences = []
    for word, more in sorted((total(now) - total(before)).items()):
        files = {
            file: n - before.get(file, {}).get(word, 0)
            for file, words in now.items()
            if (n := words.get(word, 0)) > before.get(file, {}).get(word, 0)
        }
        where = ", ".join(f"{n} in {file}" for file, n in files.items())
        sentences.append(
            f"{word!r} names something {more} times more ({where}): write {shape.INSTEAD[word]}."
        )
    return sentences


def test_no_word_is_used_more() -> None:
    assert added(counts(PACKAGE), json.loads(TABLE.read_text("utf-8"))) == []


def test_a_word_more_is_seen(tmp_path: Path) -> None:
    (tmp_path / "room").mkdir()
    source = "def own(held, *, x=1):\n    _found = held.found\n    return f(told=x)\n"
    (tmp_path / "room" / "file.py").write_text(source)
    now = counts(tmp_path)
    assert now == {"room/file.py": {"found": 2, "held": 2, "own": 1, "told": 1}}
    assert added(now, now) == []
    (sentence,) = added(now, {"moved.py": {"found": 2, "held": 2, "own": 1}})
    assert sentence.startswith("'told' names something 1 times more (1 in room/file.py): write ")


@pytest.mark.parametrize("name", ["a finding", "towns", "held_out"])
def test_parts_of_names_do_not_count(tmp_path: Path, name: str) -> None:
    (tmp_path / "file.py").write_text(f"x = {name.replace(' ', '_')}")
    assert counts(tmp_path) == {}


if __name__ == "__main__":
    lines = [f"{json.dumps(file)}: {json.dumps(words)}" for file, words in counts(PACKAGE).items()]
    print("{\n" + ",\n".join(lines) + "\n}")
