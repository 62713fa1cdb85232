"""Study of transfer functions: every section computes and writes its part of the page."""

from __future__ import annotations

import pytest

from studies.black_box import STUDIES, main, run


def assert_numbers(page: str) -> None:
    rows = [line for line in page.splitlines() if line.startswith("|")]
    assert len(rows) >= 5
    assert "nan" not in page
    assert "inf" not in page


@pytest.mark.long
def test_a_section_has_numbers():
    study = STUDIES["processes"]
    assert_numbers("\n".join(study.write(1, {task: study.work(*task) for task in study.tasks(1)})))


@pytest.mark.long
def test_the_page_says_how_it_was_made_and_is_the_same_whatever_the_processes():
    page = run(1, 1, ["published"])
    assert run(1, 2, ["published"]) == page
    assert "--seeds 1 --only published" in page
    assert "errors in variables (printed)" in page
    assert_numbers(page.partition("## ")[2])


def test_wrong_arguments_are_one_line(tmp_path, capsys):
    assert main(["--out", str(tmp_path / "page.md"), "--seeds", "0"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_what_is_said_has_numbers():
    study = STUDIES["process-confidence"]
    tasks = [task for task in study.tasks(1) if task[1:] == ("prbs", "white", 0) and task[0] != "order"]
    assert [task[0] for task in tasks] == ["open", "closed"]
    results = {task: study.work(*task) for task in tasks}
    page = "\n".join(study.write(1, results))
    assert "feedback" not in results[tasks[0]]["right"].status
    assert "feedback" in results[tasks[1]].status
    assert "| prbs |" in page
    assert " nan " not in page
