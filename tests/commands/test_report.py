import json
import sys
from pathlib import Path
from typing import Any

import pytest

from lerobot_gloves.commands import main
from tests.benchmark.rows import ROWS, row


def gloves(monkeypatch: pytest.MonkeyPatch, *options: str) -> str:
    """Run the command; what it says at its end."""
    monkeypatch.setattr(sys, "argv", ["gloves", "report", *options])
    try:
        main()
    except SystemExit as end:
        return str(end.code)
    return ""


def write(folder: Path, rows: list[dict[str, Any]]) -> Path:
    folder.mkdir()
    for number, one in enumerate(rows):
        (folder / f"{number}.json").write_text(json.dumps(one))
    return folder


def test_all_outputs_of_one_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = write(tmp_path / "rows", ROWS)
    files = {name: tmp_path / "new" / f"report.{name}" for name in ("md", "csv", "html")}
    options = [f"--output={files['md']}", f"--csv={files['csv']}", f"--html={files['html']}", "--paper=true"]
    assert gloves(monkeypatch, f"--rows={rows}", *options) == ""
    printed = capsys.readouterr().out
    assert printed == files["md"].read_text()
    assert ", published" in printed
    assert files["csv"].read_text().startswith("task,split,agent,")
    assert files["html"].read_text().startswith("<!DOCTYPE html>")


def test_several_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    first = write(tmp_path / "first", ROWS)
    second = write(tmp_path / "second", [ROWS[2], row("slow", "ifae", 0, [1, 1, 1, 1])])
    assert gloves(monkeypatch, f"--rows=[{first}, {second}]") == ""
    printed = capsys.readouterr().out
    header = next(line for line in printed.splitlines() if line.startswith("| perturbation"))
    assert header.replace(" ", "") == "|perturbation|agent|feeg+gate|ifae|"


def test_what_is_wrong_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = write(tmp_path / "rows", ROWS)
    assert f"{tmp_path / 'none'} is no folder" in gloves(monkeypatch, f"--rows=[{rows}, {tmp_path / 'none'}]")
    said = gloves(monkeypatch, f"--rows={rows}", f"--csv={tmp_path}")
    assert said == f"gloves report: cannot write {tmp_path}: Is a directory"
