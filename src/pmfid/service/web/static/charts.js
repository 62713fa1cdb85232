// Charts of one axis: a line, a band around it, a level that it is measured from; one range of time and one cursor for
// all of them. uPlot is a global of vendor/uPlot.iife.min.js.
import { el, say } from "./dom.js";
import { isWall, moment, number } from "./format.js";
import { colour } from "./theme.js";

const HEIGHT = 170, LABELS = 70;

// spec: {title, unit, line, low, high, level, levelName, steps, told(k)}; line, low, high: names of columns.
export class Chart {
  constructor(spec, group) {
    this.spec = spec;
    this.group = group; // of charts: {zoom(from, to), cursor(k), key(event), hold()}
    this.read = el("p", { class: "read" });
    this.place = el("div", { class: "plot" });
    this.element = el(
      "div",
      { class: "chart", tabindex: "0", role: "group", "aria-label": `${spec.title}: chart; arrow keys move the cursor, plus and minus zoom, 0 goes back` },
      el("div", { class: "caption" }, el("span", { class: "chart-title" }, spec.title), spec.unit ? el("span", { class: "fine" }, spec.unit) : null, this.read),
      this.place,
    );
    this.element.addEventListener("keydown", (event) => group.key(event));
  }

  make() {
    const { spec } = this;
    const grid = { stroke: colour("grid"), width: 1 };
    const axis = { stroke: colour("soft"), grid, ticks: grid, font: "12px system-ui" };
    const line = { stroke: colour("line"), width: 1.6, points: { show: false }, spanGaps: false };
    const edge = { stroke: "transparent", width: 0, points: { show: false } };
    if (spec.steps) line.paths = edge.paths = uPlot.paths.stepped({ align: -1 });
    const series = [{}, edge, edge, line, { stroke: colour("level"), width: 1.4, dash: [6, 4], points: { show: false } }];
    const options = {
      width: this.width(),
      height: HEIGHT,
      legend: { show: false },
      cursor: { drag: { x: true, y: false, setScale: false }, sync: { key: "axis", setSeries: false, filters: { pub: (type) => type === "mousemove" || type === "mouseleave" } }, points: { show: false } },
      scales: { x: { time: this.wall }, y: { range: () => this.limits } },
      axes: [{ ...axis, size: 30, space: 70 }, { ...axis, size: LABELS, values: (_, ticks) => ticks.map((tick) => number(tick, 5).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "")) }],
      series,
      bands: [{ series: [2, 1], fill: colour("band") }],
      hooks: { setSelect: [(plot) => this.selected(plot)], setCursor: [(plot) => this.group.cursor(plot.cursor.idx)] },
    };
    this.plot = new uPlot(options, [[], [], [], [], []], this.place);
    this.plot.over.addEventListener("dblclick", () => this.group.zoom(null));
    this.plot.over.addEventListener("mousedown", () => this.group.hold());
  }

  width() {
    return Math.max(160, Math.floor(this.place.clientWidth) || 320);
  }

  // Room for the line, the level and the band as wide as it usually is, for at a start it is as good as endless; never
  // so narrow that rounding looks like motion.
  range(line, low, high) {
    if (this.spec.steps) [line, low, high] = [[...line, ...low, ...high], [], []];
    const widths = line.flatMap((value, k) => (value == null || low[k] == null ? [] : [Math.max(value - low[k], high[k] - value)]));
    const band = widths.sort((a, b) => a - b)[widths.length >> 1] ?? 0;
    const values = line.filter((value) => value != null);
    if (this.spec.level != null) values.push(this.spec.level);
    if (!values.length) return [0, 1];
    const least = values.reduce((a, b) => Math.min(a, b)), most = values.reduce((a, b) => Math.max(a, b));
    const middle = (least + most) / 2;
    const half = Math.max((most - least) / 2 + 1.5 * band, 0.02 * Math.abs(this.spec.level ?? 0)) * 1.08;
    return [middle - (half || 0.02 * Math.abs(middle) || 1), middle + (half || 0.02 * Math.abs(middle) || 1)];
  }

  selected(plot) {
    const { left, width } = plot.select;
    plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    if (width > 4) this.group.zoom(plot.posToVal(left, "x"), plot.posToVal(left + width, "x"));
  }

  draw(seen, from, to) {
    const wall = isWall(to);
    if (this.plot && this.wall !== wall) this.drop();
    this.wall = wall;
    this.limits ??= [0, 1];
    if (!this.plot) this.make();
    const { line, low, high, level } = this.spec;
    const none = seen.time.map(() => null);
    const flat = level == null ? none : seen.time.map(() => level);
    const data = [seen.time, low ? low(seen) : none, high ? high(seen) : none, line(seen), flat];
    this.limits = this.range(data[3], data[1], data[2]);
    this.plot.batch(() => {
      this.plot.setData(data, false);
      this.plot.setScale("x", { min: from, max: to });
      this.plot.setScale("y", { min: this.limits[0], max: this.limits[1] });
    });
  }

  tell(seen, k) {
    say(this.read, k == null ? "" : `${this.spec.told(seen, k)} at ${moment(seen.time[k])}`);
  }

  resize() {
    const width = this.width();
    if (this.plot && this.plot.width !== width) this.plot.setSize({ width, height: HEIGHT });
  }

  drop() {
    this.plot?.destroy();
    this.plot = null;
  }
}

export const LEFT = LABELS;
