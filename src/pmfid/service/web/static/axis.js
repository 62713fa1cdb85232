// One axis live: what it is now, charts of all that is known of it, its alarms.
import { alarmCard, askFirst } from "./alarms.js";
import { tell } from "./api.js";
import { Chart } from "./charts.js";
import { Columns } from "./columns.js";
import { Compare } from "./compare.js";
import { csvOf, fileName } from "./csv.js";
import { download, el, say } from "./dom.js";
import { age, number, percent, unitOf, withError, words } from "./format.js";
import { noticeLine } from "./notices.js";
import { isOpen } from "./plant.js";
import { chartSpecs } from "./specs.js";
import { MEANING, WORD, icon } from "./states.js";
import { Strip } from "./strip.js";
import { tableOf } from "./table.js";
import { onTheme } from "./theme.js";

const POINTS = 700, TURN = 200; // points of a chart; least time between two drawings [ms]
const SPANS = [[30, "30 s"], [120, "2 min"], [600, "10 min"], [Infinity, "all"]];

export class AxisView {
  constructor(plant, axis) {
    this.plant = plant;
    this.axis = axis;
    this.place = plant.place.get(axis);
    this.group = plant.groups[plant.groupOf[this.place]];
    this.nominal = plant.nominal(this.place);
    this.columns = new Columns(this.group.names.length);
    this.span = 30;
    this.zoomed = null; // [from, to] while someone looks at a part
    this.paused = null; // the time at its end while it stands still
    this.build();
    this.update();
    this.timer = setInterval(() => this.update(), 1000);
    this.unheard = onTheme(() => this.recolour());
    this.sizes = new ResizeObserver(() => this.resize());
  }

  // Called when the element is in the page: charts need its width.
  entered() {
    this.sizes.observe(this.charts);
    this.later();
  }

  stop() {
    clearInterval(this.timer);
    clearTimeout(this.drawing);
    this.unheard();
    this.sizes.disconnect();
    this.compare?.stop();
    for (const chart of this.all) chart.drop();
  }

  // Number of the last sample that is here.
  get after() {
    return this.columns.size ? this.columns.data.number[this.columns.size - 1] : -1;
  }

  take(rows) {
    if (!this.columns.add(rows)) return;
    this.noteLast(rows.received / 10);
    this.later();
  }

  // The news of one axis bring no overview: its last row is what the plant knows of it.
  noteLast(received) {
    const { plant, place, columns } = this;
    const last = (name) => columns.data[name][columns.size - 1];
    plant.received[place] = received;
    plant.state[place] = last("state");
    plant.status32[place] = last("status");
  }

  // --- what it is made of ---

  build() {
    const { group } = this;
    this.state = el("p", { class: "pill", role: "status" });
    this.facts = el("p", { class: "fine" });
    this.open = el("ul", { class: "cards", "aria-label": "Open alarms of this axis" });
    this.cards = group.names.map((name, j) => this.card(name, j));
    this.all = chartSpecs(group, this.nominal).map((spec) => new Chart(spec, this));
    this.strip = new Strip(this.plant);
    this.charts = el("div", { class: "charts" }, ...this.all.map((chart) => chart.element), this.strip.element);
    this.known = el("ul", { class: "cards" });
    this.log = el("ol", { class: "log" });
    this.rows = el("div", { class: "scrolled", tabindex: "0", role: "region", "aria-label": "Charts as a table" });
    this.asTable = el("details", { class: "more", ontoggle: () => this.draw() }, el("summary", {}, "Charts as a table"), this.rows);
    this.element = el(
      "div",
      { class: "axis" },
      el(
        "div",
        { class: "title" },
        el("a", { href: "#/", class: "back" }, "← All axes"),
        el("h1", {}, this.axis),
        this.state,
        this.facts,
      ),
      this.open,
      el("section", { "aria-label": "Estimates now", class: "values" }, ...this.cards.map((card) => card.element)),
      this.tools(),
      this.charts,
      (this.comparison = el("div", {})),
      this.asTable,
      el("section", { "aria-labelledby": "known-title", class: "past" }, el("h2", { id: "known-title" }, "Alarms of this axis"), this.known),
      el("details", { class: "more" }, el("summary", {}, "Events of this axis"), this.log),
    );
  }

  card(name, j) {
    const value = el("p", { class: "value" });
    const off = el("p", { class: "fine" });
    const unit = this.group.units[j];
    const nominal = this.nominal[j];
    const element = el("div", { class: "value-card" }, el("h2", {}, words(name)), value, off);
    return { element, value, off, unit, nominal };
  }

  tools() {
    this.pauseButton = el("button", { type: "button", "aria-pressed": "false", onclick: () => this.pause() }, "Pause");
    this.spans = SPANS.map(([span, text]) => el("button", { type: "button", "aria-pressed": String(span === this.span), onclick: () => this.setSpan(span) }, text));
    this.back = el("button", { type: "button", onclick: () => this.zoom(null), disabled: true }, "Back from zoom");
    this.compareButton = el("button", { type: "button", "aria-pressed": "false", onclick: () => this.toggleCompare() }, "Compare with reference");
    const refer = el("button", { type: "button", onclick: () => this.refer() }, "Set as reference …");
    const anew = el("button", { type: "button", onclick: () => this.beginAnew() }, "Begin anew …");
    this.said = el("p", { class: "fine", role: "status" });
    return el(
      "div",
      { class: "tools", role: "group", "aria-label": "View of the charts" },
      this.pauseButton,
      el("span", { class: "spans", role: "group", "aria-label": "Time span of the charts" }, ...this.spans),
      this.back,
      el("button", { type: "button", onclick: () => this.save() }, "Save as CSV"),
      this.compareButton,
      refer,
      anew,
      this.said,
    );
  }

  // --- what someone does ---

  pause() {
    this.paused = this.paused === null ? this.columns.end : null;
    this.pausedAt = this.columns.size ? this.columns.data.number[this.columns.size - 1] : 0;
    this.pauseButton.setAttribute("aria-pressed", String(this.paused !== null));
    say(this.pauseButton, this.paused !== null ? "Go on" : "Pause");
    this.update();
    this.draw();
  }

  setSpan(span) {
    this.span = span;
    this.spans.forEach((button, k) => button.setAttribute("aria-pressed", String(SPANS[k][0] === span)));
    this.zoom(null);
  }

  zoom(from, to) {
    this.zoomed = from === null ? null : [from, to];
    this.back.disabled = !this.zoomed;
    this.draw();
  }

  // While someone drags, nothing moves under their hand.
  hold() {
    this.held = true;
    const release = () => {
      this.held = false;
      this.later();
    };
    addEventListener("mouseup", release, { once: true });
  }

  key(event) {
    const [from, to] = this.range();
    const step = (to - from) / 10, middle = (from + to) / 2;
    const pan = { ArrowLeft: -step, ArrowRight: step }[event.key];
    if (pan && event.shiftKey) this.zoom(from + pan, to + pan);
    else if (pan) this.step(Math.sign(pan));
    else if (event.key === "+" || event.key === "=") this.zoom(middle - 2.5 * step, middle + 2.5 * step);
    else if (event.key === "-") this.zoom(middle - 10 * step, middle + 10 * step);
    else if (event.key === "0" || event.key === "Escape") this.zoom(null);
    else return;
    event.preventDefault();
  }

  // Moves the cursor of all charts by points.
  step(by) {
    if (!this.seen?.time.length) return;
    const n = this.seen.time.length;
    const at = Math.max(0, Math.min(n - 1, (this.cursorAt ?? n - 1) + by * Math.max(1, Math.round(n / 100))));
    const { plot } = this.all[0];
    plot.setCursor({ left: plot.valToPos(this.seen.time[at], "x"), top: 10 });
    this.cursor(at);
  }

  cursor(k) {
    this.cursorAt = k ?? null;
    if (!this.seen) return;
    for (const chart of this.all) chart.tell(this.seen, this.cursorAt);
    this.strip.tell(this.seen, this.cursorAt);
  }

  save() {
    const [from, to] = this.range();
    download(fileName(this.axis), csvOf(this.columns, this.group, this.plant.states, from, to), "text/csv");
  }

  toggleCompare() {
    const open = !this.compare;
    this.compareButton.setAttribute("aria-pressed", String(open));
    this.compare?.stop();
    this.compare = open ? new Compare(this.axis, this.group) : null;
    this.comparison.replaceChildren(...(open ? [this.compare.element] : []));
    this.draw();
  }

  refer() {
    const what = el("p", {}, "The present values of ", el("strong", {}, this.axis), " become the reference for deviations and alarms. This step cannot be undone.");
    askFirst("Set as reference", [what], "Set as reference", () => tell(`api/axis/${encodeURIComponent(this.axis)}/reference`, {}));
  }

  beginAnew() {
    const what = el("p", {}, "The next samples of ", el("strong", {}, this.axis), " are accepted, whatever their numbers. Use this if the sender has restarted its numbering. Estimate and reference stay as they are.");
    askFirst("Begin anew", [what], "Begin anew", () => tell(`api/axis/${encodeURIComponent(this.axis)}/anew`, {}));
  }

  // --- what is shown ---

  range() {
    if (this.zoomed) return this.zoomed;
    const { start } = this.columns;
    const end = this.paused ?? this.columns.end;
    if (!Number.isFinite(end)) return [0, 1];
    const from = this.span === Infinity ? start : end - this.span;
    return [Math.min(from, end - 1e-3), end];
  }

  later() {
    this.drawing ??= setTimeout(() => requestAnimationFrame(() => this.draw()), TURN);
  }

  draw() {
    clearTimeout(this.drawing);
    this.drawing = undefined;
    if (!this.element.isConnected || this.held) return;
    const [from, to] = this.range();
    this.seen = this.columns.thinned(from, to, POINTS, this.group.resolution);
    for (const chart of this.all) chart.draw(this.seen, from, to);
    this.strip.draw(this.seen, from, to);
    this.cursor(this.cursorAt < this.seen.time.length ? this.cursorAt : null);
    this.compare?.tellSeen(this.columns.motion(from, to, this.group));
    if (this.asTable.open) this.rows.replaceChildren(tableOf(this.seen, this.group, this.plant.states));
    this.values();
  }

  values() {
    const { columns } = this;
    if (!columns.size) return;
    const k = columns.size - 1;
    this.cards.forEach((card, j) => {
      const value = columns.data[`theta${j}`][k], std = columns.data[`std${j}`][k];
      say(card.value, `${withError(value, std)}${unitOf(card.unit)}`);
      const off = card.nominal && Number.isFinite(std) ? value / card.nominal - 1 : NaN;
      say(card.off, `${percent(off)} from nominal ${number(card.nominal)}`);
      card.element.classList.toggle("off", Math.abs(off) > 0.05);
    });
  }

  update() {
    const { plant, place, group } = this;
    const kind = plant.kind(place);
    if (kind !== this.kind) {
      this.kind = kind;
      this.state.dataset.kind = kind;
      this.state.replaceChildren(icon(kind), el("span", {}, WORD[kind]));
      this.state.title = MEANING[kind];
    }
    const end = this.columns.size ? this.columns.data.number[this.columns.size - 1] : NaN;
    const waiting = this.paused !== null ? `, paused, ${Math.max(0, end - this.pausedAt)} samples since` : "";
    say(this.facts, `data ${age(this.age())} old, a sample every ${number(1000 * group.dt)} ms, ${group.config}${waiting}`);
    this.showAlarms();
  }

  age() {
    return this.plant.age(this.place);
  }

  showAlarms() {
    const own = [...this.plant.alarms.values()].filter((alarm) => alarm.axis === this.axis).reverse();
    const key = own.map((alarm) => [alarm.number, alarm.acknowledged, alarm.cleared, alarm.settled?.time]).join() + this.plant.notices.length;
    if (key === this.alarmsSeen) return;
    this.alarmsSeen = key;
    const known = own.filter((alarm) => !isOpen(alarm));
    this.open.replaceChildren(...own.filter(isOpen).map((alarm) => alarmCard(alarm, false)));
    this.known.replaceChildren(...(known.length ? known.map((alarm) => alarmCard(alarm, false)) : [el("li", { class: "fine" }, own.length ? "the open alarms are above" : "none so far")]));
    this.putFirst(own.find((alarm) => isOpen(alarm) && !alarm.silent)?.parameter);
    const happened = this.plant.notices.filter((notice) => notice.axis === this.axis).slice(-60).reverse();
    this.log.replaceChildren(...(happened.length ? happened.map(noticeLine) : [el("li", { class: "fine" }, "nothing so far")]));
  }

  // The estimate and the chart of an alarm stand first; of a gain that is the input, for the axis itself is as before.
  putFirst(parameter) {
    if (!parameter || parameter === this.first) return;
    this.first = parameter;
    const { names } = this.group;
    const chart = parameter === "input_gain" ? names.length : names.indexOf(parameter);
    if (chart < 0) return;
    this.charts.prepend(this.all[chart].element);
    if (chart < names.length) this.cards[chart].element.parentElement.prepend(this.cards[chart].element);
  }

  recolour() {
    for (const chart of this.all) chart.drop();
    this.compare?.stop();
    this.draw();
    this.compare?.redraw();
  }

  resize() {
    for (const chart of this.all) chart.resize();
    this.compare?.resize();
    if (this.seen) this.strip.draw(this.seen, ...this.range());
  }
}
