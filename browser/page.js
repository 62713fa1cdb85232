// The form, the table and the figure. pmfid itself runs in the worker.
import { parquetReadObjects } from "hyparquet";
import { compressors } from "hyparquet-compressors";

const METHODS = ["iv", "bcls", "ls", "riv", "bcrls", "rls"];
const at = (id) => document.getElementById(id);
const form = at("form"), field = form.elements;
let worker, drawn = null, calls = 0;
const waiting = new Map();

/** Return the bytes that `write_text` of the build has put into the page. */
function readParts() {
  const element = at("parts"), text = element.textContent, bytes = new Uint8Array(text.length);
  element.remove();
  const codes = new Map();
  for (let byte = 128; byte < 160; byte++) codes.set(new TextDecoder("windows-1252").decode(Uint8Array.of(byte)).charCodeAt(0), byte);
  let size = 0;
  for (let k = 0; k < text.length; k++) {
    const escaped = text[k] === "=" ? 64 : 0, code = text.charCodeAt(escaped ? ++k : k);
    bytes[size++] = (code > 159 && code < 256 ? code : (codes.get(code) ?? code)) - escaped;
  }
  return bytes.subarray(0, size);
}

async function start() {
  const packed = new Blob([readParts()]).stream().pipeThrough(new DecompressionStream("gzip"));
  const payload = new Uint8Array(await new Response(packed).arrayBuffer());
  const first = 4 + new DataView(payload.buffer).getUint32(0, true), parts = {};
  let place = first;
  for (const [name, size] of Object.entries(JSON.parse(new TextDecoder().decode(payload.subarray(4, first))))) {
    parts[name] = payload.slice(place, place += size);
  }
  worker = new Worker(URL.createObjectURL(new Blob([parts["worker.js"]], { type: "text/javascript" })));
  worker.onmessage = ({ data: [id, answer, problem] }) => {
    const [resolve, reject] = waiting.get(id);
    waiting.delete(id);
    if (problem === null) resolve(answer); else reject(new Error(problem));
  };
  delete parts["worker.js"];
  await call("start", parts);
  at("file").disabled = false;
  at("state").textContent = "Ready.";
}

const call = (name, ...args) => new Promise((resolve, reject) => {
  waiting.set(++calls, [resolve, reject]);
  worker.postMessage([calls, name, args]);
});

/** Do long work with a sentence on the page; return null after a problem, which the page shows. */
async function work(sentence, task) {
  const began = performance.now();
  at("problem").hidden = at("result").hidden = true;
  at("state").textContent = sentence;
  for (const button of document.querySelectorAll("button, #file")) button.disabled = true;
  let answer = null;
  try {
    answer = await task();
  } catch (error) {
    answer = { problem: `The page failed: ${error.message.trim().split("\n").pop()}` };
  }
  for (const button of document.querySelectorAll("button, #file")) button.disabled = false;
  at("state").textContent = answer.problem ? "No result." : `Done in ${((performance.now() - began) / 1000).toFixed(1)} s.`;
  if (answer.problem) {
    at("problem").textContent = answer.problem;
    at("problem").hidden = false;
  }
  return answer;
}

async function openLog(file) {
  form.reset();
  const answer = await work(`Reading ${file.name} ...`, async () => {
    const data = await file.arrayBuffer();
    if (new TextDecoder("latin1").decode(data.slice(0, 4)) !== "PAR1") return call("open_log", file.name, new Uint8Array(data));
    let rows;
    try {
      rows = await parquetReadObjects({ file: data, compressors });
    } catch {
      return { problem: `${file.name}: this Parquet file is damaged; export the record again` };
    }
    const number = (value) => value === null ? NaN : value instanceof Date ? value.getTime() / 1000 : Number(value);
    const columns = Object.fromEntries(Object.keys(rows[0] ?? {}).map((name) => [name, Float64Array.from(rows, (row) => number(row[name]))]));
    return call("open_log", file.name, null, columns);
  });
  form.hidden = !answer.columns;
  if (answer.columns) fill(answer);
  if (answer.left_out?.length) at("state").textContent += ` Left out, as not numeric: ${answer.left_out.join(", ")}.`;
}

function fill({ columns, resolution, axis: { record = {}, encoder = {}, model = {} } }) {
  for (const name of ["input", "output", "time"]) {
    const none = name === "time" ? [new Option("no such column", "")] : [];
    field[name].replaceChildren(...none, ...columns.map((column) => new Option(column, column)));
    field[name].value = record[name] ?? none[0]?.value ?? columns[0];
  }
  field.output_kind.value = record.output_kind ?? "position";
  field.dt.value = record.dt ?? "";
  field.resolution.value = encoder.resolution ?? "";
  field.bits.value = encoder.bits ?? "";
  field.input_gain.value = model.input_gain ?? "";
  field.resolution.placeholder = resolution && resolution !== 1 ? `${resolution} in the unit of the log: write m, mm or deg` : "0.01 mm, 0.1 deg or 2000 counts/rev";
  field.axis.value = model.axis ?? "";
  at("period").hidden = field.time.value !== "";
}

function show(answer) {
  for (const name of ["sentence", "action", "axis"]) at(name).textContent = answer[name];
  const spare = answer.header.map((name) => ["std", "model spread"].includes(name) && answer.header.includes("95 %"));
  const row = (kind, cells) => cells.reduce((line, cell, column) => (line.append(Object.assign(document.createElement(kind), { textContent: cell, className: spare[column] ? "spare" : "" })), line), document.createElement("tr"));
  at("head").replaceChildren(row("th", answer.header));
  at("rows").replaceChildren(...answer.rows.map((cells) => row("td", cells)));
  for (const name of ["findings", "notes"]) {
    at(name).replaceChildren(...answer[name].map((text) => Object.assign(document.createElement("li"), { textContent: text })));
  }
  at("result").hidden = false;
  document.querySelector("figure").hidden = !answer.figure;
  drawn = answer.figure;
  if (drawn) draw(drawn);
  at("result").scrollIntoView({ block: "start" });
}

/** Draw the motion, and the error below it, with the smallest and largest value of each axis. */
function draw({ t, measured, simulated, error, unit }) {
  const svg = at("figure"), width = svg.clientWidth, left = 64, right = width - 12;
  const make = (name, settings, text = "") => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(settings)) element.setAttribute(key, value);
    element.textContent = text;
    svg.append(element);
  };
  const panel = (top, bottom, label, curves) => {
    const values = Object.values(curves).flat(), low = Math.min(...values), high = Math.max(...values, low + 1e-300);
    const x = (value) => left + (right - left) * (value - t[0]) / (t.at(-1) - t[0]), y = (value) => bottom - (bottom - top) * (value - low) / (high - low);
    make("path", { class: "frame", d: `M${left} ${top}V${bottom}H${right}` });
    make("text", { x: left, y: top - 8 }, `${label}${unit ? ` [${unit}]` : ""}`);
    for (const [value, place] of [[low, bottom], [high, top + 10]]) make("text", { x: left - 6, y: place, "text-anchor": "end" }, value && Math.abs(value) < 1e-3 ? value.toExponential(1) : Number(value.toPrecision(3)));
    for (const [name, curve] of Object.entries(curves)) make("path", { class: name, d: curve.map((value, k) => `${k ? "L" : "M"}${x(t[k]).toFixed(1)} ${y(value).toFixed(1)}`).join("") });
  };
  svg.replaceChildren();
  panel(22, 210, "position", { measured, simulated });
  panel(248, 315, "measured less simulated", { error });
  make("text", { x: right, y: 334, "text-anchor": "end" }, `${Number((t.at(-1) - t[0]).toPrecision(3))} s`);
}

field.method.append(...METHODS.map((name) => new Option(name, name)));
field.time.addEventListener("change", () => { at("period").hidden = field.time.value !== ""; });
field.output.addEventListener("change", async () => {
  const answer = await work("Looking at the columns ...", () => call("suggest", field.output.value));
  if (answer.axis.record) fill(answer);
});
form.addEventListener("submit", async (event) => {
  event.preventDefault();
  const answers = Object.fromEntries(new FormData(form));
  if (answers.time) answers.dt = "";
  const answer = await work("Identifying ...", () => call("identify_log", answers));
  window.answer = answer; // for tests
  if (!answer.problem) show(answer);
});
at("file").addEventListener("click", ({ target }) => { target.value = ""; }); // the same file again is a change
at("file").addEventListener("change", ({ target }) => { if (target.files[0]) openLog(target.files[0]); });
for (const name of ["dragover", "dragleave", "drop"]) {
  at("drop").addEventListener(name, (event) => {
    event.preventDefault();
    at("drop").classList.toggle("over", name === "dragover");
    const file = event.dataTransfer.files[0];
    if (name === "drop" && file && !at("file").disabled) openLog(file);
  });
}
window.addEventListener("resize", () => { if (drawn && !at("result").hidden) draw(drawn); });
start().catch((error) => { at("state").textContent = `This browser cannot run the page: ${error.message}`; });
