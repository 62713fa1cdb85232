// What the charts show as a table, for those who do not see them, and for those who want numbers.
import { el } from "./dom.js";
import { moment, number, unitOf, withError, words } from "./format.js";

const ROWS = 40;

export function tableOf(seen, group, states) {
  const heads = ["t", ...group.names.map((name, j) => `${words(name)}${unitOf(group.units[j])}`), "input", "velocity", "innovation", "state"];
  const step = Math.max(1, Math.ceil(seen.time.length / ROWS));
  const rows = [];
  for (let k = seen.time.length - 1; k >= 0; k -= step) rows.push(rowOf(seen, group, states, k));
  const caption = el("caption", {}, "latest first, ± one standard deviation");
  const head = el("thead", {}, el("tr", {}, ...heads.map((text) => el("th", { scope: "col" }, text))));
  return el("table", {}, caption, head, el("tbody", {}, ...rows));
}

function rowOf(seen, group, states, k) {
  const values = group.names.map((_, j) => withError(seen[`theta${j}`][k] ?? NaN, seen[`std${j}`][k] ?? NaN));
  const signals = [seen.u[k], seen.velocity[k], seen.innovation[k]].map((value) => number(value ?? NaN));
  const cells = [...values, ...signals, states[seen.state[k]] ?? "–"].map((text) => el("td", {}, text));
  return el("tr", {}, el("th", { scope: "row" }, moment(seen.time[k])), ...cells);
}
