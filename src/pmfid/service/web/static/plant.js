// What the page knows of the plant: arrays over all axes, alarms by number, notices, counters.
import { unpacked } from "./packed.js";

const NOTICES = 500;

export const isOpen = (alarm) => alarm.acknowledged === null && alarm.cleared === null;

export class Plant {
  constructor(facts) {
    Object.assign(this, facts); // name, layout, states, status, groups, every
    this.starts = [];
    this.names = [];
    for (const group of this.groups) {
      this.starts.push(this.names.length);
      this.names.push(...group.axes);
    }
    const n = this.names.length;
    this.place = new Map(this.names.map((name, i) => [name, i]));
    this.groupOf = new Uint32Array(n);
    this.groups.forEach((group, g) => this.groupOf.fill(g, this.starts[g], this.starts[g] + group.axes.length));
    this.received = new Float64Array(n).fill(NaN);
    this.value = new Float32Array(n).fill(NaN);
    this.std = new Float32Array(n).fill(NaN);
    this.deviation = new Float32Array(n).fill(NaN);
    this.status32 = new Uint32Array(n);
    this.state = new Uint8Array(n);
    this.lead = this.groups.map((group) => Math.max(0, group.nominal.findIndex((value) => value !== 0)));
    this.patience = this.groups.map((group) => Math.max(5, 5 * this.every, 5 * group.dt));
    this.alarms = new Map();
    this.open = new Map(); // axis -> its alarms that nobody acknowledged, and that are not over
    this.notices = [];
    this.counters = [];
    this.clock = [0, performance.now()];
    this.version = 0; // of the last news
  }

  now() {
    return this.clock[0] + (performance.now() - this.clock[1]) / 1000;
  }

  age(i) {
    return this.now() - this.received[i];
  }

  silent(i) {
    return !(this.age(i) <= this.patience[this.groupOf[i]]);
  }

  kind(i) {
    if (this.changed(i)) return "alarm";
    if (this.silent(i)) return "silent";
    return this.states[this.state[i]].replace(" ", "-");
  }

  // The last open alarm of an axis that says more than that it is silent.
  changed(i) {
    return this.open.get(this.names[i])?.findLast((alarm) => !alarm.silent);
  }

  // Whether an axis is counted and listed under a kind: a silent one under its alarm, too.
  is(i, kind) {
    return kind === "silent" ? this.silent(i) : this.kind(i) === kind;
  }

  // Returns the alarms that are new to this page, but for those of the first message.
  take(news) {
    this.version = news.version;
    this.clock = [news.now / 10, performance.now()];
    for (const group of news.groups) this.takeGroup(group);
    const fresh = news.first ? [] : news.alarms.filter((alarm) => !this.alarms.has(alarm.number));
    for (const alarm of news.alarms) this.alarms.set(alarm.number, alarm);
    if (news.first) this.notices = news.notices;
    else this.notices.push(...news.notices);
    if (this.notices.length > 2 * NOTICES) this.notices = this.notices.slice(-NOTICES);
    this.counters = news.counters;
    if (news.alarms.length || news.first) this.sortAlarms();
    return fresh.filter(isOpen);
  }

  takeGroup(group) {
    const start = this.starts[group.group];
    const axis = unpacked(group.axis);
    const columns = ["value", "std", "deviation", "state"].map((name) => [this[name], unpacked(group[name])]);
    columns.push([this.status32, unpacked(group.status)]);
    const received = unpacked(group.received);
    for (let k = 0; k < axis.length; k++) {
      const i = start + axis[k];
      this.received[i] = received[k] / 10;
      for (const [mine, theirs] of columns) mine[i] = theirs[k];
    }
  }

  sortAlarms() {
    this.open = new Map();
    for (const alarm of this.alarms.values()) {
      if (!isOpen(alarm)) continue;
      if (!this.open.has(alarm.axis)) this.open.set(alarm.axis, []);
      this.open.get(alarm.axis).push(alarm);
    }
  }

  // Number of the last open alarm of an axis, 0 for none.
  latestAlarm(i) {
    return this.open.get(this.names[i])?.at(-1).number ?? 0;
  }

  openAlarms() {
    return [...this.open.values()].flat().sort((a, b) => b.number - a.number);
  }

  // Normal values of an axis: its own since someone set it as reference, else those of its configuration.
  nominal(i) {
    const g = this.groupOf[i];
    return this.referred[g]?.[i - this.starts[g]] ?? this.groups[g].nominal;
  }

  bits(status) {
    return this.status.filter((one) => one.bit & status);
  }
}
