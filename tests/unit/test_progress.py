"""Progress is shown where it is asked for."""

import os
import pty
import select
import sys

import pytest

from kreisel.progress import CellLine, of_parts, shown


def work(show):
    for share in (0.0, 0.5, 1.0):
        show("pass 1", share)
    show("checks", 1.0)


@pytest.mark.parametrize("asked", [None, False])
def test_nothing_is_shown_unless_asked_for(asked, capsys):
    with shown(asked) as show:
        assert show is None
    assert capsys.readouterr() == ("", "")


def test_an_own_function_is_called():
    heard = []
    with shown(lambda step, share: heard.append((step, share))) as show:
        work(show)
    assert heard == [("pass 1", 0.0), ("pass 1", 0.5), ("pass 1", 1.0), ("checks", 1.0)]


def test_names_of_steps_are_written_where_there_is_no_terminal(capsys):
    with shown(True) as show:
        work(show)
    assert capsys.readouterr() == ("", "pass 1\nchecks\n")


def test_a_terminal_shows_one_line_and_is_left_clean(monkeypatch):
    reader, writer = pty.openpty()
    monkeypatch.setenv("TERM", "xterm")
    with os.fdopen(writer, "w") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        with shown(True) as show:
            work(show)
        terminal.flush()
        text = ""
        while select.select([reader], [], [], 1.0)[0]:  # the terminal hands on what was written in parts
            text += os.read(reader, 65536).decode()
    os.close(reader)
    assert "checks" in text
    assert text.endswith("\x1b[1A\x1b[2K") or "\x1b[2K" in text.rpartition("checks")[2]


def test_a_cell_has_one_line_that_says_at_last_how_long_it_took():
    texts, now = [], [100.0]
    line = CellLine(lambda first: texts.append(first) or texts.append, lambda: now[0])
    for share, later in ((0.25, 0.0), (0.3, 0.05), (1.5, 1.01)):
        now[0] += later
        line("pass 1", share)
    line.finish()
    assert texts == [
        "",
        "pass 1           █████░░░░░░░░░░░░░░░  25 %  0.0 s",
        "pass 1           ████████████████████ 100 %  1.1 s",
        "done in 1.1 s",
    ]


def test_parts_report_the_mean_of_their_shares():
    heard = []
    one, other = of_parts(lambda step, share: heard.append((step, share)), "checks", 2)
    one("first", 1.0)
    other("second", 0.5)
    assert heard == [("checks", 0.5), ("checks", 0.75)]
