"""The first day of new users, short in this environment, and whole from a fresh one."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from first_day import play


@pytest.mark.slow  # what they type: `tests/commands`, and the README's quickstart
def test_users_get_what_they_came_for(tmp_path: Path) -> None:
    """Of each kind one: what the others type runs in tests/commands, design and recordings."""
    day = play.Day(Path(sys.executable), tmp_path)
    play.own_choices(day)
    play.an_infeasible_design(day)
    play.the_paper(day, readings=4)
    commands = [user for user, _, _ in day.typed]
    assert all(commands.count(user) <= most for user, (most, _) in play.BARS.items())


@pytest.mark.slow
def test_the_whole_day_from_a_fresh_environment_meets_its_bars(tmp_path: Path) -> None:
    assert play.main(tmp_path) == []
