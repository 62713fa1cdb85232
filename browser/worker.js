// Runs pmfid in Pyodide, apart from the page. The page sends the files of Pyodide; nothing is fetched.
"use strict";
const STORED = "file:///pyodide/";
let ready = null;

async function start(parts) {
  self.fetch = async (request) => {
    const name = String(request.url ?? request).split("/").pop();
    if (!parts[name]) throw new Error(`${name} is not in the page`);
    const type = name.endsWith(".wasm") ? "application/wasm" : "application/octet-stream";
    return new Response(parts[name], { headers: { "Content-Type": type } });
  };
  const pyodide = self.pyodide = await loadPyodide({ indexURL: STORED, lockFileURL: STORED + "pyodide-lock.json" });
  await pyodide.loadPackage(["numpy", "scipy"], { messageCallback: () => {} });
  pyodide.unpackArchive(parts["pmfid.zip"], "zip", { extractDir: "/pmfid" });
  pyodide.runPython("import sys; sys.path.insert(0, '/pmfid')");
  return pyodide.pyimport("analyse");
}

self.onmessage = async ({ data: [id, name, args] }) => {
  try {
    if (name === "start") ready = start(args[0]);
    const module = await ready;
    const answer = name === "start" ? "null" : module[name](...args);
    self.postMessage([id, JSON.parse(answer), null]);
  } catch (error) {
    self.postMessage([id, null, String(error.message ?? error)]);
  }
};
