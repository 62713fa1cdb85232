// Trends of the axes that are in sight: fetched when they come into it, and again now and then.
import { ask } from "./api.js";
import { svg } from "./dom.js";
import { unpacked } from "./packed.js";

const FRESH = 10000; // [ms]
const WIDTH = 120, HEIGHT = 28;

export class Trends {
  constructor(plant, changed) {
    this.plant = plant;
    this.changed = changed;
    this.kept = new Map(); // axis -> {at, values, interval}
    this.asking = false;
  }

  // The trend of an axis, null where it is not here yet.
  of(i) {
    return this.kept.get(i) ?? null;
  }

  async want(axes) {
    const now = performance.now();
    const missing = axes.filter((i) => !(now - (this.kept.get(i)?.at ?? -Infinity) < FRESH)).slice(0, 150);
    if (!missing.length || this.asking) return;
    this.asking = true;
    try {
      for (const group of new Set(missing.map((i) => this.plant.groupOf[i]))) {
        await this.fetch(group, missing.filter((i) => this.plant.groupOf[i] === group));
      }
      if (this.kept.size > 2000) this.kept = new Map([...this.kept].slice(-500));
      this.changed();
    } catch {
      // the page says what is wrong with the connection
    } finally {
      this.asking = false;
    }
  }

  async fetch(group, axes) {
    const start = this.plant.starts[group];
    const answer = await (await ask(`api/trends?group=${group}&axes=${axes.map((i) => i - start)}`)).json();
    const values = unpacked(answer.trends);
    axes.forEach((i, k) => {
      this.kept.set(i, {
        at: performance.now(),
        interval: answer.interval,
        values: values.subarray(k * answer.points, (k + 1) * answer.points),
      });
    });
  }
}

// A line around nominal, which is the thin line in the middle; at least 3 % up and down fit, so that noise looks small.
export function trendLine(trend) {
  const drawing = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "trend", "aria-hidden": "true", preserveAspectRatio: "none" });
  const middle = HEIGHT / 2;
  drawing.append(svg("line", { x1: 0, x2: WIDTH, y1: middle, y2: middle, class: "trend-zero" }));
  if (!trend) return drawing;
  let largest = 0.03;
  for (const value of trend.values) if (Math.abs(value) > largest) largest = Math.abs(value);
  const step = WIDTH / Math.max(1, trend.values.length - 1);
  let path = "", pen = "M";
  trend.values.forEach((value, k) => {
    if (Number.isFinite(value)) {
      path += `${pen}${(k * step).toFixed(1)} ${(middle - (value / largest) * (middle - 2)).toFixed(1)}`;
      pen = "L";
    } else if (pen === "L") pen = "M";
  });
  if (path) drawing.append(svg("path", { d: path, class: "trend-line" }));
  return drawing;
}
