// The reference record beside what is seen: is the work the same? Same scales, and the same numbers of both.
import { Problem, ask } from "./api.js";
import { Chart } from "./charts.js";
import { Amount } from "./columns.js";
import { el } from "./dom.js";
import { number, unitOf } from "./format.js";

export class Compare {
  constructor(axis, group) {
    this.axis = axis;
    this.group = group;
    this.body = el("div", {}, el("p", { class: "note" }, "One moment …"));
    this.element = el("section", { class: "compare", "aria-labelledby": "compare-title" }, el("h2", { id: "compare-title" }, "Reference record"), this.body);
    this.load();
  }

  async load() {
    try {
      this.record = parsed(await (await ask(`api/axis/${encodeURIComponent(this.axis)}/reference.csv`)).text(), this.group.resolution);
      this.build();
    } catch (error) {
      this.body.replaceChildren(el("p", { class: "problem", role: "alert" }, error instanceof Problem ? error.message : "the reference cannot be read"));
    }
  }

  build() {
    const { group, record } = this;
    const still = { zoom: () => {}, hold: () => {}, cursor: (k) => this.charts?.forEach((chart) => chart.tell(record, k)), key: () => {} };
    const speed = `${group.position_unit}/s`;
    this.charts = [
      new Chart({ title: "input, reference", unit: group.input_unit, line: (seen) => seen.u, steps: true, told: (seen, k) => `${number(seen.u[k])}${unitOf(group.input_unit)}` }, still),
      new Chart({ title: "velocity, reference", unit: speed, line: (seen) => seen.velocity, told: (seen, k) => `${number(seen.velocity[k])} ${speed}` }, still),
    ];
    this.table = el("tbody", {});
    const heads = ["Quantity", "Reference", "What is seen"].map((text) => el("th", { scope: "col" }, text));
    const table = el("table", {}, el("caption", {}, "How much it moves"), el("thead", {}, el("tr", {}, ...heads)), this.table);
    this.body.replaceChildren(el("div", { class: "charts" }, ...this.charts.map((chart) => chart.element)), table);
    this.redraw();
    this.tellSeen(this.seen);
  }

  redraw() {
    const { record } = this;
    if (!record) return;
    const span = Math.min(record.time.at(-1), 30);
    for (const chart of this.charts) chart.draw(record, 0, span);
  }

  resize() {
    this.charts?.forEach((chart) => chart.resize());
  }

  // seen: how much there is of input and velocity in what is seen, as `Columns.motion` tells it.
  tellSeen(seen) {
    this.seen = seen;
    if (!this.table || !seen) return;
    const { group, record } = this;
    const units = { input: unitOf(group.input_unit), velocity: ` ${group.position_unit}/s` };
    const told = { input: new Amount(record.u), velocity: new Amount(record.velocity) };
    const rows = ["input", "velocity"].flatMap((name) => [
      [`${name}, root mean square`, told[name].rms, seen[name].rms, units[name]],
      [`${name}, largest`, told[name].most, seen[name].most, units[name]],
    ]);
    this.table.replaceChildren(
      ...rows.map(([name, a, b, unit]) => el("tr", {}, el("th", { scope: "row" }, name), el("td", {}, number(a) + unit), el("td", {}, number(b) + unit))),
    );
  }

  stop() {
    this.charts?.forEach((chart) => chart.drop());
  }
}

function parsed(text, resolution) {
  const rows = text.trim().split("\n").slice(1).map((line) => line.split(",").map(Number));
  const time = rows.map((row) => row[0]);
  const u = rows.map((row) => (Number.isFinite(row[1]) ? row[1] : null));
  const velocity = rows.map((row, k) => (k ? (resolution * (row[2] - rows[k - 1][2])) / (row[0] - rows[k - 1][0]) : null));
  return { time, u, velocity, state: [], status: [] };
}
