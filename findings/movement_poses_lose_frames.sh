#!/usr/bin/env bash
# movement 0.15.0: frames of DeepLabCut's files are counted anew, and SLEAP without tracks keeps
# one instance a frame.
#
# Behaviour: `from_dlc_file` numbers rows 0, 1, 2, … whatever the first column (the frame) says;
# `from_sleap_file` of a project without tracks returns one individual, the last instance of each
# frame, and only logs a warning.
# Why it matters: a video of which frames were dropped, or a part of it was analysed, has wrong
# times and speeds; of two whiskers one is lost, and the one that is kept may change from frame
# to frame.
# Output seen: frames 0 1 250 251 are read as 0 1 2 3; 2 instances a frame, 1 read: y = 120 121 22 23
# Fails if frames and instances are kept, or another version is installed.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q "movement==0.15.0" "sleap-io==0.9.5"
cd "$work"
"$work/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version

import numpy as np
import sleap_io
from movement.io import load_poses

assert version("movement") == "0.15.0", version("movement")
rows = ["scorer,DLC,DLC,DLC", "bodyparts,tip,tip,tip", "coords,x,y,likelihood"]
with open("a.csv", "w") as file:
    file.write("\n".join([*rows, *(f"{frame},10,50,0.99" for frame in (0, 1, 250, 251))]) + "\n")
frames = load_poses.from_dlc_file("a.csv")["time"].values.astype(int).tolist()

bones = sleap_io.Skeleton(["base", "tip"])
video = sleap_io.Video(filename="a.mp4", open_backend=False)
labelled = []
for i in range(4):
    pair = [
        sleap_io.PredictedInstance.from_numpy(
            np.array([[10.0, y + i], [90.0, y + i]]), skeleton=bones, score=0.9,
            point_scores=np.ones(2),
        )
        for y in (20, 120)
    ]
    labelled.append(
        sleap_io.LabeledFrame(video=video, frame_idx=i, instances=pair if i < 2 else pair[::-1])
    )
sleap_io.save_slp(sleap_io.Labels(labelled, [video], [bones]), "a.slp")
poses = load_poses.from_sleap_file("a.slp")
y = poses["position"].sel(space="y").isel(keypoints=0).values[:, 0].astype(int).tolist()

print("frames 0 1 250 251 are read as", *frames, end="; ")
print(f"2 instances a frame, {poses.sizes['individuals']} read: y =", *y)
assert frames == [0, 1, 2, 3], "frames are kept now"
assert poses.sizes["individuals"] == 1 and y == [120, 121, 22, 23], "instances are kept now"
PYTHON
