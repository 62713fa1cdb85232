// Validity over time: the state of the monitor, and a lane for each bit of the status that was set in what is seen.
import { el, say } from "./dom.js";
import { words } from "./format.js";
import { LEFT } from "./charts.js";
import { WORD } from "./states.js";
import { colour } from "./theme.js";

const LANE = 18, GAP = 4, AXIS = 4;

export class Strip {
  constructor(plant) {
    this.plant = plant;
    this.canvas = el("canvas", { role: "img", "aria-label": "validity over time" });
    this.labels = el("ul", { class: "lanes" });
    this.read = el("p", { class: "read" });
    this.element = el(
      "div",
      { class: "chart strip" },
      el("div", { class: "caption" }, el("span", { class: "chart-title" }, "Validity"), this.read),
      el("div", { class: "strip-body" }, this.canvas),
      this.labels,
    );
  }

  kindOf(state) {
    return this.plant.states[state]?.replace(" ", "-") ?? "starting";
  }

  draw(seen, from, to) {
    const all = seen.status.reduce((found, status) => found | status, 0);
    const bits = this.plant.bits(all);
    const height = (bits.length + 1) * (LANE + GAP) + AXIS;
    const width = this.canvas.parentElement.clientWidth;
    const ratio = devicePixelRatio || 1;
    this.canvas.width = width * ratio;
    this.canvas.height = height * ratio;
    this.canvas.style.width = `${width}px`;
    this.canvas.style.height = `${height}px`;
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const x = (time) => LEFT + ((time - from) / (to - from)) * (width - LEFT - 8);
    this.lane(pen, seen, x, 0, width, (k) => colour(`state-${this.kindOf(seen.state[k])}`));
    bits.forEach((one, lane) => this.lane(pen, seen, x, lane + 1, width, (k) => (seen.status[k] & one.bit ? colour("bit") : null)));
    this.write(pen, bits);
    this.tellLanes(seen, bits);
  }

  lane(pen, seen, x, lane, width, fill) {
    const top = lane * (LANE + GAP);
    pen.fillStyle = colour("lane");
    pen.fillRect(LEFT, top, width - LEFT - 8, LANE);
    for (let k = 0; k < seen.time.length; k++) {
      const style = fill(k);
      if (!style) continue;
      const left = Math.max(LEFT, k ? x(seen.time[k - 1]) : x(seen.time[k]));
      const right = Math.min(width - 8, x(seen.time[k]));
      if (right <= left) continue;
      pen.fillStyle = style;
      pen.fillRect(left, top, right - left + 0.6, LANE);
    }
  }

  write(pen, bits) {
    pen.fillStyle = colour("soft");
    pen.font = "12px system-ui";
    pen.textBaseline = "middle";
    pen.textAlign = "right";
    ["state", ...bits.map((_, k) => String(k + 1))].forEach((text, lane) => pen.fillText(text, LEFT - 8, lane * (LANE + GAP) + LANE / 2));
  }

  // The lanes in words: what was set, for how much of what is seen, and what to do about it.
  tellLanes(seen, bits) {
    const n = seen.time.length || 1;
    const share = (count) => `${Math.max(1, Math.round((100 * count) / n))} %`;
    const states = [...new Set(seen.state)].filter((state) => state !== null);
    const parts = states.map((state) => `${WORD[this.kindOf(state)].toLowerCase()} ${share(seen.state.filter((one) => one === state).length)}`);
    const lines = [`state: ${parts.join(", ") || "no rows"}`];
    for (const [k, one] of bits.entries()) {
      lines.push(`${k + 1} ${words(one.name)}, ${share(seen.status.filter((status) => status & one.bit).length)}: ${one.advice}`);
    }
    if (lines.join() !== this.told) {
      this.told = lines.join();
      this.labels.replaceChildren(...lines.map((line) => el("li", {}, line)));
      this.canvas.setAttribute("aria-label", `validity over time; ${lines[0]}`);
    }
  }

  tell(seen, k) {
    if (k == null) return say(this.read, "");
    const bits = this.plant.bits(seen.status[k]).map((one) => words(one.name));
    say(this.read, [WORD[this.kindOf(seen.state[k])].toLowerCase(), ...bits].join(", "));
  }
}
