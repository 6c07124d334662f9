#!/usr/bin/env bash
# Expyriment 1.0.1: `read_datafile` does not read back what `exp.data.add` writes.
#
# Behaviour: a text with a comma is written between quotes ("left, then right"), as CSV has it, but
# Expyriment's own reader splits every line at every comma: that row has one field more than the
# others, the quotes stay, and what follows stands one column too far to the right. A text with a
# quote and no comma has it doubled without quotes around (5" bar becomes 5"" bar), which neither
# this reader nor that of Python's csv module, which reads the first text rightly, undoes.
# Why: `DataFile.add` (expyriment/io/_files.py) encloses texts with commas alone, and
# `read_datafile` (expyriment/misc/data_preprocessing/_data_preprocessing.py) calls `split(",")`.
# Why it matters: nothing is raised. `rt` of such a trial is read as " then right", and by
# `Aggregator` or a script that takes columns by their place a label or a time is another one.
# A CSV reader that skips lines with # reads commas rightly.
# Output seen: ['1', '2', '"left', ' then right"', '655'] by Expyriment
#              ['1', '2', 'left, then right', '655'] by csv
#              ['1', '3', '5"" bar', '501'] by both
# Fails if the reader or the writer changes, or another version is installed.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q "expyriment==1.0.1"
cd "$work"
cat > rig.py <<'PYTHON'
import csv
import os

os.environ["SDL_VIDEODRIVER"] = os.environ["SDL_AUDIODRIVER"] = "dummy"
import expyriment
from expyriment import control, design
from expyriment.misc.data_preprocessing import read_datafile

assert expyriment.__version__.startswith("1.0.1"), expyriment.__version__
control.defaults.opengl = 0
experiment = design.Experiment("touch")
control.set_develop_mode(True)
control.initialize(experiment)
experiment.data_variable_names = ["trial", "answer", "rt"]
control.start(skip_ready_screen=True, subject_id=1)
experiment.data.add([1, "left", 412])
experiment.data.add([2, "left, then right", 655])
experiment.data.add([3, '5" bar', 501])
experiment.data.save()
path = experiment.data.fullpath

rows, names, *_ = read_datafile(path)
with open(path, encoding="utf-8") as file:
    header, *by_csv = csv.reader(line for line in file if not line.startswith("#"))
control.end(goodbye_delay=0)
print(rows[1], "by Expyriment")
print(by_csv[1], "by csv")
print(rows[2], "by Expyriment", by_csv[2], "by csv")
assert names == header == ["subject_id", "trial", "answer", "rt"]
assert rows[0] == by_csv[0] == ["1", "1", "left", "412"]
assert rows[1] == ["1", "2", '"left', ' then right"', "655"], "the reader has changed"
assert by_csv[1] == ["1", "2", "left, then right", "655"]
assert rows[2] == by_csv[2] == ["1", "3", '5"" bar', "501"], "the writer has changed"
PYTHON
"$work/venv/bin/python" rig.py
