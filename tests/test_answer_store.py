"""Kept answers: by question, whole or not at all, refused in one line, and safe with several writers."""

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.files.answer_store import (
    StoredResultLines,
    cache_folder,
    claim_folder,
    hash_inputs,
    read_stored_result,
    replace_file_atomically,
    write_stored_result,
)

OTHER = ("answers another question", "give another place")
DAMAGED = ("is damaged", "delete it")


def test_a_question_is_its_content() -> None:
    asked = {"b": (1, 2.0), "a": Path("x")}
    assert hash_inputs(asked) == hash_inputs(dict(reversed(asked.items())))
    assert hash_inputs(np.array([1.0, 2.0])) != hash_inputs(np.array([1.0, np.nextafter(2.0, 3.0)]))
    assert hash_inputs("ab", "c") != hash_inputs("a", "bc")


@pytest.mark.parametrize("name", ["answer.json", "answer.npz"])
def test_an_answer_is_that_of_its_question(tmp_path: Path, name: str) -> None:
    path = tmp_path / "new" / name
    assert read_stored_result(path, "q", damaged=DAMAGED, other=OTHER) is None
    write_stored_result(path, "q", {"x": np.array([1.0, np.nan]), "why": ""})
    found = read_stored_result(path, "q")
    assert found is not None
    np.testing.assert_array_equal(found["x"], [1.0, np.nan])
    assert found["why"] == ""
    assert read_stored_result(path, "other") is None
    with pytest.raises(InputError, match="answers another question; give another place"):
        read_stored_result(path, "other", other=OTHER)
    path.write_bytes(path.read_bytes()[:-20])
    assert read_stored_result(path, "q", other=OTHER) is None
    with pytest.raises(InputError, match="is damaged; delete it"):
        read_stored_result(path, "q", damaged=DAMAGED)


def test_several_writers_and_a_fault_leave_a_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "answer.json"
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda k: write_stored_result(path, "q", {"x": [k] * 1000}), range(40)))
    found = read_stored_result(path, "q")
    assert found is not None
    assert len(set(found["x"])) == 1

    def full() -> None:
        with replace_file_atomically(path) as part:
            part.write_text("half")
            raise OSError(28, "No space left on device")

    with pytest.raises(InputError, match="cannot be written"):
        full()
    assert read_stored_result(path, "q") == found
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_belongs_to_one_question(tmp_path: Path) -> None:
    for _ in range(2):
        claim_folder(tmp_path, "note.json", "q", {"seed": 1}, OTHER)
    with pytest.raises(InputError, match=f"{tmp_path.name}: answers another question"):
        claim_folder(tmp_path, "note.json", "other", {}, OTHER)
    assert json.loads((tmp_path / "note.json").read_text()) == {"question": "q", "seed": 1}


def test_lines_are_recalled_up_to_the_one_that_was_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "answers.jsonl"

    def lines(**more: object) -> StoredResultLines[int]:
        return StoredResultLines(path, lambda row: (row[0], row[1]), question="q", other=OTHER, **more)  # type: ignore[arg-type]

    first = lines()
    for k in range(3):
        first.append_result(k, k * k, [k, k * k])
    path.write_bytes(path.read_bytes()[:-3])
    again = lines(damaged=DAMAGED)
    assert again.known == {0: 0, 1: 1}
    again.append_result(2, 4, [2, 4])
    assert lines().known == {0: 0, 1: 1, 2: 4}
    head, *rest = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(head + rest[0] + b"nonsense\n" + rest[2])
    with pytest.raises(InputError, match="line 3: is damaged"):
        lines(damaged=DAMAGED)
    assert lines().known == {0: 0}
    path.write_bytes(b'{"question": "other"}\n')
    with pytest.raises(InputError, match="answers another question"):
        lines()
    lines_in_memory: StoredResultLines[int] = StoredResultLines(None, lambda row: (row, row))
    lines_in_memory.append_result(1, 1, [])
    lines_in_memory.delete_file()
    assert lines_in_memory.known == {1: 1}


def test_the_cache_can_be_elsewhere_or_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUFLY_CACHE", str(tmp_path))
    assert cache_folder("polars") == tmp_path / "polars"
    monkeypatch.setenv("MUFLY_CACHE", "OFF")
    assert cache_folder("polars") is None
