// All axes: how many are in which state, open alarms, and the table, what needs someone first.
import { alarmCard } from "./alarms.js";
import { el, say } from "./dom.js";
import { number, words } from "./format.js";
import { noticeLine } from "./notices.js";
import { Rows } from "./rows.js";
import { KINDS, MEANING, WORD, icon } from "./states.js";

const CARDS = 4;
const SORTS = { attention: "most urgent first", name: "name", deviation: "largest deviation first", age: "oldest data first" };

export class Overview {
  constructor(plant) {
    this.plant = plant;
    this.filter = "all";
    this.sort = "attention";
    this.text = "";
    this.allAlarms = false;
    this.rows = new Rows(plant);
    this.build();
    this.update();
    this.timer = setInterval(() => this.update(), 1000);
  }

  stop() {
    clearInterval(this.timer);
    this.rows.stop();
  }

  build() {
    this.tiles = new Map(["all", ...KINDS].map((kind) => [kind, this.tile(kind)]));
    const search = el("input", { type: "search", id: "search", placeholder: "name or configuration", oninput: () => this.find(search.value) });
    const sort = el(
      "select",
      { id: "sort", onchange: () => this.set({ sort: sort.value }) },
      ...Object.entries(SORTS).map(([value, text]) => el("option", { value }, text)),
    );
    this.shown = el("p", { class: "fine", role: "status" });
    this.cards = el("ul", { class: "cards" });
    this.more = el("button", { type: "button", class: "quiet", onclick: () => this.set({ allAlarms: !this.allAlarms }) });
    this.alarms = el("section", { "aria-labelledby": "alarms-title", class: "alarms" }, el("h2", { id: "alarms-title" }, "Open alarms"), this.cards, this.more);
    this.failing = el("p", { class: "problem", role: "status" });
    this.log = el("ol", { class: "log" });
    this.totals = el("dl", { class: "totals" });
    this.element = el(
      "div",
      { class: "overview" },
      el("h1", { class: "unseen" }, "All axes"),
      el("div", { class: "tiles", role: "group", "aria-label": "Axes by state; press a state to list only its axes" }, ...this.tiles.values()),
      this.failing,
      this.alarms,
      el(
        "section",
        { "aria-labelledby": "axes-title", class: "list" },
        el(
          "div",
          { class: "tools" },
          el("h2", { id: "axes-title" }, "Axes"),
          el("span", { class: "labelled" }, el("label", { for: "search" }, "Search"), search),
          el("span", { class: "labelled" }, el("label", { for: "sort" }, "First"), sort),
          this.shown,
        ),
        this.rows.element,
      ),
      el("details", { class: "more" }, el("summary", {}, "Events"), this.log),
      el("details", { class: "more" }, el("summary", {}, "Counters: received, dropped and refused"), this.totals),
    );
  }

  tile(kind) {
    const count = el("span", { class: "count" }, "0");
    const name = kind === "all" ? "All" : WORD[kind];
    const title = kind === "all" ? "every axis" : MEANING[kind];
    const button = el(
      "button",
      { type: "button", class: "tile", title, "data-kind": kind, "aria-pressed": "false", onclick: () => this.set({ filter: kind === this.filter ? "all" : kind }) },
      kind === "all" ? null : icon(kind), count, el("span", { class: "tile-name" }, name),
    );
    button.count = count;
    return button;
  }

  set(what) {
    Object.assign(this, what);
    this.update(true);
  }

  find(text) {
    this.text = text.trim().toLowerCase();
    this.update(true);
  }

  // asked: by someone, so that rows may move under their hand.
  update(asked = false) {
    if (!asked && document.hidden) return;
    const kinds = this.plant.names.map((_, i) => KINDS.indexOf(this.plant.kind(i)));
    this.count(kinds);
    this.showAlarms();
    this.showFailing();
    this.showLog();
    if (this.rows.focused && !asked) this.rows.draw(true);
    else this.rows.show(this.ordered(kinds));
    const n = this.rows.order.length;
    const all = this.plant.names.length;
    say(this.shown, `${n} of ${all} ${all === 1 ? "axis" : "axes"}`);
  }

  count(kinds) {
    const counts = new Map([["all", kinds.length], ...KINDS.map((kind, k) => [kind, kinds.filter((one) => one === k).length])]);
    counts.set("silent", kinds.filter((_, i) => this.plant.silent(i)).length);
    this.allSilent = kinds.length > 0 && counts.get("silent") === kinds.length;
    for (const [kind, tile] of this.tiles) {
      say(tile.count, String(counts.get(kind)));
      tile.classList.toggle("none", counts.get(kind) === 0);
      tile.setAttribute("aria-pressed", String(this.filter === kind));
    }
  }

  ordered(kinds) {
    const { plant, filter, text } = this;
    const wanted = [];
    for (let i = 0; i < kinds.length; i++) {
      if (filter !== "all" && !plant.is(i, filter)) continue;
      if (text && !plant.names[i].toLowerCase().includes(text) && !plant.groups[plant.groupOf[i]].config.toLowerCase().includes(text)) continue;
      wanted.push(i);
    }
    const size = (i) => Math.abs(plant.deviation[i]) || 0;
    const old = (i) => (Number.isFinite(plant.received[i]) ? plant.received[i] : -Infinity);
    const orders = {
      attention: (a, b) => kinds[a] - kinds[b] || plant.latestAlarm(b) - plant.latestAlarm(a) || a - b,
      name: (a, b) => (plant.names[a] < plant.names[b] ? -1 : 1),
      deviation: (a, b) => size(b) - size(a) || a - b,
      age: (a, b) => (old(a) === old(b) ? a - b : old(a) - old(b)),
    };
    return wanted.sort(orders[this.sort]);
  }

  showAlarms() {
    const open = this.plant.openAlarms();
    this.alarms.hidden = open.length === 0;
    const seen = open.map((alarm) => [alarm.number, alarm.settled?.time]).join() + this.allAlarms;
    if (seen === this.seen) return;
    this.seen = seen;
    const shown = this.allAlarms ? open.slice(0, 200) : open.slice(0, CARDS);
    this.cards.replaceChildren(...shown.map((alarm) => alarmCard(alarm)));
    this.more.hidden = open.length <= CARDS;
    say(this.more, this.allAlarms ? "Show only the latest alarms" : `Show all ${open.length} alarms`);
  }

  // Sources, sinks and checkpoints that do not work: what they said may long be out of the list of what happened.
  showFailing() {
    const failing = this.plant.counters
      .filter(([name, , value]) => name.endsWith("_working") && value === 0)
      .map(([name, labels]) => [name.slice("pmfid_".length, -"_working".length), ...Object.values(labels)].join(" "));
    const told = [this.allSilent ? "No axis sends data" : null, failing.length ? `Not working: ${failing.join(", ")}` : null];
    say(this.failing, told.filter(Boolean).join(". "));
    this.failing.hidden = !told.some(Boolean);
  }

  showLog() {
    const last = this.plant.notices.at(-1)?.number;
    if (last !== this.logged) {
      this.logged = last;
      this.log.replaceChildren(...this.plant.notices.slice(-60).reverse().map(noticeLine));
    }
    const rows = this.plant.counters.map(([name, labels, value]) => {
      const which = Object.values(labels).join(", ");
      return el("div", {}, el("dt", {}, `${words(name.replace(/^pmfid_|_total$/g, ""))}${which ? ` (${which})` : ""}`), el("dd", {}, number(value, 7)));
    });
    this.totals.replaceChildren(...(rows.length ? rows : [el("div", {}, el("dt", {}, "nothing yet"), el("dd", {}, "–"))]));
  }
}
