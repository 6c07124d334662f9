// What the three pages share: a worker with Python, forms in, results out. Text that comes from a
// file or from Python is only ever set as text.
const script = document.querySelector("script[data-pyodide]");
const status = document.getElementById("status");
const results = document.getElementById("results");
const form = document.querySelector("form");

// A worker from a blob is bound by this page's content security policy; one from a file is not.
const here = new URL("worker.js", document.baseURI);
const blob = new Blob([`import ${JSON.stringify(here.href)};`], { type: "text/javascript" });
const worker = new Worker(URL.createObjectURL(blob), { type: "module" });
const waiting = new Map();
let last = 0;

worker.onmessage = ({ data }) => {
  if (data.stage) return say(data.stage);
  const { resolve, reject } = waiting.get(data.id);
  waiting.delete(data.id);
  return data.error ? reject(new Error(data.error)) : resolve(JSON.parse(data.answer));
};
worker.onerror = (event) => say(`Python could not be started: ${event.message}`, true);

function ask(name, fields) {
  return new Promise((resolve, reject) => {
    waiting.set(++last, { resolve, reject });
    worker.postMessage({ id: last, name, fields });
  });
}

function say(words, wrong = false) {
  status.textContent = words;
  status.classList.toggle("wrong", wrong);
}

function element(tag, text = "", more = {}) {
  return Object.assign(document.createElement(tag), { textContent: text }, more);
}

// -- one call at a time; of those that wait, the newest ------------------------------------------

let busy = false;
let next = null;

async function run(name, fields, done = show) {
  if (busy) {
    next = [name, fields, done];
    return;
  }
  busy = true;
  say("Computing …");
  document.body.setAttribute("aria-busy", "true");
  try {
    const answer = await ask(name, fields);
    if (answer.error) say(answer.error, true);
    else {
      say("Done.");
      done(answer);
    }
  } catch (error) {
    say(`This should not happen: ${error.message}`, true);
  }
  busy = false;
  document.body.setAttribute("aria-busy", "false");
  if (next) {
    const [...waited] = next;
    next = null;
    run(...waited);
  }
}

// -- results ------------------------------------------------------------------------------------

let made = [];

function link(content, type) {
  const url = URL.createObjectURL(new Blob([content], { type }));
  made.push(url);
  return url;
}

function show({ texts = [], figures = [], tables = [], files = [] }) {
  made.splice(0).forEach((url) => URL.revokeObjectURL(url));
  results.replaceChildren();
  for (const { title, body, folded } of texts) {
    const words = element("p", body, { className: "words" });
    if (folded) {
      const box = element("details");
      box.append(element("summary", title), words);
      results.append(box);
    } else results.append(element("h2", title), words);
  }
  for (const { title, svg } of figures) {
    const figure = element("figure");
    const url = link(svg, "image/svg+xml");
    figure.append(
      element("img", "", { src: url, alt: title }),
      element("figcaption", `${title}. `),
    );
    figure.lastChild.append(element("a", "Keep as SVG", { href: url, download: "figure.svg" }));
    results.append(figure);
  }
  for (const { title, columns, rows } of tables) results.append(tableOf(title, columns, rows));
  for (const { name, base64 } of files) {
    const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
    const url = link(bytes, "application/octet-stream");
    results.append(element("a", `Keep ${name}`, { href: url, download: name, className: "file" }));
  }
}

function tableOf(title, columns, rows) {
  const box = element("div", "", { className: "wide", tabIndex: 0 });
  box.setAttribute("role", "region");
  box.setAttribute("aria-label", title);
  const table = element("table");
  table.createCaption().textContent = title;
  const head = table.createTHead().insertRow();
  for (const name of columns) head.append(element("th", name, { scope: "col" }));
  const body = table.createTBody();
  for (const cells of rows) {
    const row = body.insertRow();
    for (const cell of cells) row.append(element("td", cell));
  }
  box.append(table);
  return box;
}

// -- forms --------------------------------------------------------------------------------------

let given = null; // the table to be read: a dropped one, or the sample

function fields() {
  const all = Object.fromEntries(new FormData(form));
  if (given) all.file = given;
  return all;
}

function showNumbers() {
  for (const range of form.querySelectorAll("input[type=range]")) {
    range.parentElement.querySelector("output").textContent = range.value;
  }
}

function fill({ set = {} }) {
  for (const [name, value] of Object.entries(set)) form.elements[name].value = value;
  showNumbers();
  if ("live" in form.dataset) run(form.dataset.call, fields());
}

function menus({ menus: wanted = [], texts }) {
  const place = document.getElementById("menus");
  place.replaceChildren();
  for (const { name, label, options, value, values_of: of, values = {} } of wanted) {
    const select = element("select", "", { name });
    const offer = (more) => {
      select.replaceChildren();
      for (const [v, words] of [...options, ...more.map((v) => [v, v])]) {
        select.append(element("option", words, { value: v }));
      }
      select.value = value;
    };
    offer([]);
    if (of) {
      const source = place.querySelector(`select[name=${of}]`);
      const follow = () => offer(values[source.value] ?? []);
      source.addEventListener("change", follow);
      follow();
    }
    const box = element("label", `${label} `);
    box.append(select);
    place.append(box);
  }
  show({ texts });
}

function take(file) {
  given = file;
  form.elements.file.required = false;
  document.getElementById("drop").dataset.name = file.name;
  run("columns", fields(), menus);
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  run(form.dataset.call, fields());
});
form.addEventListener("input", showNumbers);
let pause = 0;
form.addEventListener("change", ({ target }) => {
  if (target.dataset.preset) {
    if (target.value) run(target.dataset.preset, fields(), fill);
  } else if (target.type === "file") {
    if (target.files.length) take(target.files[0]);
  }
});
if ("live" in form.dataset) {
  form.addEventListener("input", ({ target }) => {
    if (target.dataset.preset) return;
    clearTimeout(pause);
    pause = setTimeout(() => run(form.dataset.call, fields()), 150);
  });
}
for (const button of form.querySelectorAll("[data-sample]")) {
  button.addEventListener("click", async () => {
    const name = button.dataset.sample;
    take(new File([await (await fetch(name)).blob()], name));
  });
}
const drop = document.getElementById("drop");
if (drop) {
  for (const kind of ["dragover", "drop"]) {
    document.addEventListener(kind, (event) => event.preventDefault());
  }
  document.addEventListener("drop", ({ dataTransfer }) => {
    if (dataTransfer.files.length) take(dataTransfer.files[0]);
  });
}

showNumbers();
worker.postMessage({ start: new URL(script.dataset.pyodide, document.baseURI).href });
if ("live" in form.dataset) run(form.dataset.call, fields());
