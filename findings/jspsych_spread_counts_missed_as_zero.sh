#!/usr/bin/env bash
# jsPsych 8.3.0: `mean()` of reaction times leaves out trials without an answer; `median()`, `sd()`,
# `variance()` and `min()` count each of them as 0 ms.
#
# Behaviour: a trial that times out has `rt: null`. With three answers of 400, 500 and 600 ms and one
# timeout `jsPsych.data.get().select("rt")` has the mean 500 of the answered ones, the median 450,
# the sd 300 (in place of 500 and 100), and the minimum 0.
# Why: in JavaScript null is 0 in sums, differences and sorting; `DataColumn.mean` alone skips it
# (jspsych/src/modules/data/DataColumn.ts).
# Why it matters: these numbers decide within the session: feedback, a deadline set from median and
# sd, who is let on to the test. They are wrong as soon as one trial is missed, by more for
# worse observers, and the mean beside them looks right. `filterCustom(t => t.rt !== null)` first.
# Output seen: rt 400 500 600 null: mean 500, median 450, sd 300, minimum 0
# Fails if the others skip null too, or another version is installed. Needs node 20.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm init -y >/dev/null
npm install --silent --no-audit --no-fund \
    jspsych@8.3.0 @jspsych/plugin-html-keyboard-response@2.2.0 jsdom@26.1.0
cat > session.js <<'NODE'
const assert = require("node:assert");
const { readFileSync } = require("node:fs");
const { JSDOM } = require("jsdom");

assert.equal(JSON.parse(readFileSync("node_modules/jspsych/package.json")).version, "8.3.0");
const { window } = new JSDOM("<!doctype html><body></body>", {
  runScripts: "outside-only", pretendToBeVisual: true, url: "http://localhost/",
});
for (const name of ["jspsych", "@jspsych/plugin-html-keyboard-response"])
  window.eval(readFileSync(`node_modules/${name}/dist/index.browser.min.js`, "utf8"));

// Three answers at given times by jsPsych's own simulation; the fourth trial is run and times out.
window.eval(`(async () => {
  const session = initJsPsych();
  const trial = { type: jsPsychHtmlKeyboardResponse, stimulus: "touch", choices: ["f", "j"] };
  const answered = [400, 500, 600].map((rt) => (
    { ...trial, simulation_options: { data: { rt, response: "f" } } }
  ));
  const missed = { ...trial, trial_duration: 100, simulation_options: { simulate: false } };
  await session.simulate([...answered, missed], "data-only");
  return session.data.get();
})()`).then((data) => {
  const rt = data.select("rt");
  const values = [...rt.values];
  const seen = [rt.mean(), rt.median(), rt.sd(), rt.min()];
  console.log(
    `rt ${values.map(String).join(" ")}: mean ${seen[0]}, median ${seen[1]}, ` +
    `sd ${seen[2]}, minimum ${seen[3]}`);
  assert.deepEqual(values, [400, 500, 600, null], "a timeout is no null now");
  assert.equal(seen[0], 500);
  assert.equal(seen[1], 450, "the median leaves out missed trials now");
  assert.ok(Math.abs(seen[2] - 300) < 1, "the sd leaves out missed trials now");
  assert.equal(seen[3], 0);
  assert.equal(data.filterCustom((trial) => trial.rt !== null).select("rt").median(), 500);
  process.exit(0);
});
NODE
node session.js
