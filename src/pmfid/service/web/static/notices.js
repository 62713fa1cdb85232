// Events in one line each.
import { causeOf, describeChanges, rateOf } from "./alarms.js";
import { el } from "./dom.js";
import { number, wall, words } from "./format.js";

const SENTENCES = {
  alarm: (what) => `alarm: ${causeOf(what)}`,
  cleared: (what) => `alarm ${what.alarm} is over: ${what.silent === "axis" ? "" : `${what.name} `}was silent for ${number(what.seconds)} s`,
  state: (what) => `${what.state}${what.reason ? `: ${what.reason}` : ""}`,
  settled: (what) => `now ${Object.entries(what.parameters ?? {}).map(([name, found]) => `${words(name)} ${number(found?.value)}`).join(", ")}${describeChanges(what) ? `; ${describeChanges(what)}` : ""}${what.rate ? `. ${rateOf(what.rate)}` : ""}`,
  acknowledged: (what) => `alarm ${what.alarm ?? what.number} acknowledged${what.note ? `: “${what.note}”` : ""}`,
  gap: (what) => `${what.missing} samples are missing`,
  clock: (what) => `the clock was set by ${number(what.jump)} s`,
  outlier: (what) => `${what.signal} that no motion explains; this sample is left out`,
  anew: () => "the next samples are accepted, whatever their numbers",
  source: (what) => `source ${what.source}: ${what.problem || "works"}`,
  sink: (what) => `sink ${what.sink}: ${what.problem || "works"}`,
  late: (what) => what.problem,
  reference: (what) => (what.problem ? `no new reference: ${what.problem}` : "the present values are the new reference"),
};

// Of an event that this page has no sentence for, all that it says.
function plainly({ axis, number: _, wall: at, event, time, ...rest }) {
  const details = Object.entries(rest).filter(([, value]) => typeof value !== "object" && value !== "");
  const shown = (value) => (typeof value === "number" && !Number.isInteger(value) ? number(value) : String(value));
  return `${words(event)}${details.length ? ": " : ""}${details.map(([key, value]) => `${words(key)} ${shown(value)}`).join(", ")}`;
}

export function noticeLine(notice) {
  const text = (SENTENCES[notice.event] ?? plainly)(notice);
  return el("li", {}, el("time", {}, wall(notice.wall)), " ", el("strong", {}, notice.axis || "service"), ` ${text}`);
}
