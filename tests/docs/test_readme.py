"""The README is kept true: its example runs."""

import re
from pathlib import Path


def test_the_example_runs_as_printed(capsys):
    text = (Path(__file__).parents[2] / "README.md").read_text("utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(example.strip().splitlines()) <= 13
    exec(compile(example, "README.md", "exec"), {})
    said = capsys.readouterr().out
    assert "held: a stable contact" in said
    assert "converged" in said
