// The table of axes: only the rows in sight are there, whatever the number of axes; a table to a screen reader all the
// same, which is told how many rows it has.
import { axisLink } from "./alarms.js";
import { el, say } from "./dom.js";
import { age, percent, unitOf, withError, words } from "./format.js";
import { MEANING, WORD, icon } from "./states.js";
import { Trends, trendLine } from "./trends.js";

const MARGIN = 6; // rows beyond what is in sight
const COLUMNS = ["State", "Axis", "Leading parameter", "Off nominal", "Trend", "Age of data", "Why"];

export class Rows {
  constructor(plant) {
    this.plant = plant;
    this.order = [];
    this.rows = new Map(); // axis -> its row
    this.trends = new Trends(plant, () => this.draw(true));
    this.body = el("div", { role: "rowgroup", class: "rows" });
    const heads = COLUMNS.map((name) => el("span", { role: "columnheader" }, name));
    this.trendHead = heads[COLUMNS.indexOf("Trend")];
    const head = el("div", { role: "rowgroup" }, el("div", { role: "row", class: "row head", "aria-rowindex": "1" }, ...heads));
    this.element = el("div", { role: "table", class: "axes", "aria-label": "Axes" }, head, this.body);
    this.element.addEventListener("keydown", (event) => this.key(event));
    this.look = () => this.draw(false);
    addEventListener("scroll", this.look, { passive: true });
    addEventListener("resize", this.look);
  }

  stop() {
    removeEventListener("scroll", this.look);
    removeEventListener("resize", this.look);
  }

  get focused() {
    return this.body.contains(document.activeElement);
  }

  show(order) {
    this.order = order;
    this.element.setAttribute("aria-rowcount", String(order.length + 1));
    this.draw(true);
  }

  range() {
    this.height = parseFloat(getComputedStyle(this.element).getPropertyValue("--row")) || 44;
    const top = -this.body.getBoundingClientRect().top;
    const first = Math.max(0, Math.floor(top / this.height) - MARGIN);
    return [first, Math.min(this.order.length, Math.ceil((top + innerHeight) / this.height) + MARGIN)];
  }

  // all: what they say may have changed; else only where they are.
  draw(all) {
    if (!this.body.isConnected) return;
    const [first, last] = this.range();
    this.body.style.height = `${this.order.length * this.height}px`;
    const wanted = this.order.slice(first, Math.max(first, last));
    const keep = new Set(wanted);
    for (const [i, row] of this.rows) {
      if (!keep.has(i)) {
        row.element.remove();
        this.rows.delete(i);
      }
    }
    wanted.forEach((i, k) => this.place(i, first + k, all));
    this.trends.want(wanted);
    const trend = this.trends.of(wanted[0]);
    if (trend) say(this.trendHead, `Trend, ${age(trend.interval * trend.values.length)}`);
  }

  place(i, index, all) {
    let row = this.rows.get(i);
    const fresh = !row;
    if (fresh) {
      row = this.made(i);
      this.rows.set(i, row);
    }
    if (fresh || all) this.fill(i, row);
    if (row.index !== index) {
      row.index = index;
      row.element.style.transform = `translateY(${index * this.height}px)`;
      row.element.setAttribute("aria-rowindex", String(index + 2));
      const next = [...this.body.children].find((other) => Number(other.getAttribute("aria-rowindex")) > index + 2);
      if (fresh || !row.element.contains(document.activeElement)) this.body.insertBefore(row.element, next ?? null);
    }
  }

  made(i) {
    const cells = Object.fromEntries(
      ["state", "axis", "value", "off", "trend", "age", "why"].map((name) => [name, el("span", { role: "cell", class: `c-${name}` })]),
    );
    const name = this.plant.names[i];
    const config = this.plant.groups[this.plant.groupOf[i]].config;
    cells.axis.append(el("a", { href: axisLink(name), class: "axis-name" }, name), el("span", { class: "fine config" }, config));
    cells.bar = el("span", { class: "off-bar", "aria-hidden": "true" });
    cells.percent = el("span", {});
    cells.off.append(cells.percent, cells.bar);
    const parts = [cells.state, cells.axis, cells.value, cells.off, cells.trend, cells.age, cells.why];
    return { element: el("div", { role: "row", class: "row" }, ...parts), cells, kind: "", index: -1 };
  }

  fill(i, row) {
    const { plant } = this;
    const { cells } = row;
    const kind = plant.kind(i);
    if (row.kind !== kind) {
      row.kind = kind;
      row.element.dataset.kind = kind;
      cells.state.replaceChildren(icon(kind), el("span", {}, WORD[kind]));
    }
    const group = plant.groups[plant.groupOf[i]];
    const lead = plant.lead[plant.groupOf[i]];
    const known = Number.isFinite(plant.received[i]);
    // a weaker motor, or a wrong scale of the encoder, looks like more of every parameter: then this factor is shown
    const changed = plant.changed(i);
    const factor = ["input_gain", "encoder_scale"].includes(changed?.parameter) ? changed : null;
    const value = known ? `${words(group.names[lead])} ${withError(plant.value[i], plant.std[i])}${unitOf(group.units[lead])}` : "–";
    const deviation = factor ? factor.relative : plant.deviation[i];
    say(cells.value, factor ? words(factor.parameter) : value);
    say(cells.percent, percent(deviation));
    const off = Math.max(-0.1, Math.min(0.1, deviation || 0));
    cells.bar.style.setProperty("--off", off / 0.1);
    say(cells.age, age(plant.age(i)));
    say(cells.why, this.why(i, kind));
    const trend = this.trends.of(i);
    if (row.trend !== trend || !cells.trend.firstChild) {
      row.trend = trend;
      cells.trend.replaceChildren(trendLine(trend));
    }
  }

  why(i, kind) {
    if (kind === "alarm") return this.plant.changed(i).text + (this.plant.silent(i) ? "; data have stopped" : "");
    if (kind === "silent") return Number.isFinite(this.plant.received[i]) ? "data have stopped" : "nothing has come yet";
    const bits = this.plant.bits(this.plant.status32[i]).map((one) => words(one.name));
    if (bits.length) return bits.join(", ");
    return kind === "watching" ? "" : MEANING[kind];
  }

  key(event) {
    const steps = { ArrowDown: 1, ArrowUp: -1, PageDown: 10, PageUp: -10 };
    const link = event.target.closest?.(".axis-name");
    if (!link || !(event.key in steps)) return;
    event.preventDefault();
    const at = this.order.indexOf(this.plant.place.get(link.textContent));
    const to = Math.max(0, Math.min(this.order.length - 1, at + steps[event.key]));
    const top = this.body.getBoundingClientRect().top + scrollY + to * this.height;
    if (top < scrollY + 120 || top > scrollY + innerHeight - 2 * this.height) scrollTo(0, top - innerHeight / 2);
    this.draw(false);
    this.rows.get(this.order[to])?.element.querySelector("a").focus({ preventScroll: true });
  }
}
