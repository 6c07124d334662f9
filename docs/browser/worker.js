// Python beside the page, so that the page stays quick: one call after the other.
const base = new URL(".", import.meta.url);
let pages;

async function start(pyodide) {
  const tell = (stage) => self.postMessage({ stage });
  tell("Loading Python …");
  const { loadPyodide } = await import(`${pyodide}pyodide.mjs`);
  const python = await loadPyodide({ indexURL: pyodide });
  tell("Loading NumPy, SciPy, pandas and Matplotlib …");
  const quiet = { messageCallback() {} };
  await python.loadPackage(["numpy", "scipy", "pandas", "matplotlib"], quiet);
  tell("Loading weberwhisk …");
  const archive = await fetch(new URL("weberwhisk.zip", base));
  python.unpackArchive(await archive.arrayBuffer(), "zip", { extractDir: "/lib/weberwhisk" });
  python.runPython("import sys; sys.path.insert(0, '/lib/weberwhisk')");
  const module = python.pyimport("pages");
  tell("Ready.");
  return { python, module };
}

async function answer({ id, name, fields }) {
  try {
    const { python, module } = await pages;
    for (const [key, value] of Object.entries(fields)) {
      if (value instanceof File) {
        fields[key] = `/tmp/${value.name.replaceAll("/", "_") || "table.csv"}`;
        python.FS.writeFile(fields[key], new Uint8Array(await value.arrayBuffer()));
      }
    }
    self.postMessage({ id, answer: module.call(name, JSON.stringify(fields)) });
  } catch (error) {
    self.postMessage({ id, error: error.message.trim().split("\n").at(-1) });
  }
}

self.onmessage = ({ data }) => {
  if (data.start) pages = start(data.start);
  else answer(data);
};
