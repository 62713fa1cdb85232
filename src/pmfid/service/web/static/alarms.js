// Alarms as cards, and the dialog in which one is acknowledged with a note.
import { Problem, tell } from "./api.js";
import { el } from "./dom.js";
import { moment, number, percent, unitOf, wall, withError, words } from "./format.js";
import { isOpen } from "./plant.js";
import { icon } from "./states.js";

// All changes of an alarm, the largest first.
const changesOf = (alarm) => [alarm, ...(alarm.further ?? [])];

export function causeOf(alarm) {
  if (alarm.silent) return alarm.problem;
  const others = alarm.others ? `, or ${words(alarm.others)}` : "";
  return changesOf(alarm).map(changeOf).join(" and ") + others;
}

function changeOf(change) {
  const std = Number.isFinite(change.std) ? ` ± ${number(change.std, 2)}` : "";
  const size = Number.isFinite(change.change) ? ` (${change.change > 0 ? "+" : ""}${number(change.change, 3)}${std}${unitOf(change.unit)})` : "";
  if (!Number.isFinite(change.relative)) return `${words(change.parameter)} has changed${size}`;
  const way = change.relative < 0 ? "lower" : "higher";
  return `${words(change.parameter)} is ${percent(Math.abs(change.relative)).replace("+", "")} ${way} than normal${size}`;
}

// How urgent an alarm is: its size against the tolerance, and whether the parameter keeps changing.
export function urgencyOf(alarm) {
  const size = alarm.tolerance > 0 ? [`The change is ${number(Math.abs(alarm.relative) / alarm.tolerance, 2)} times the tolerance of ${percent(alarm.tolerance).replace("+", "")}.`] : [];
  const course = alarm.settled?.rate ? `${rateOf(alarm.settled.rate)}.` : alarm.settled ? "So far it is one step." : "The new value is not known yet.";
  return [...size, course].join(" ");
}

// The words for a relative change per hour that goes on.
export function rateOf(rate) {
  const [unit, hours] = Math.abs(rate) < 0.01 ? ["a day", 24] : ["an hour", 1];
  return `It keeps changing by about ${percent(hours * rate)} ${unit}`;
}

export const sinceOf = (alarm) => (alarm.silent ? "" : `This change began at ${moment(alarm.changed_at)}. `) + `The service noticed it at ${wall(alarm.wall)}.`;

// How sure an alarm is.
const sureOf = (alarm) =>
  `How sure: the evidence is ${number(alarm.statistic / alarm.threshold, 2)} times what an alarm needs. ` +
  "While nothing is wrong, an alarm occurs about once in the time that mtbf_hours in AXIS.toml sets.";

// The changes by all samples since the alarm, or those of the alarm while these are not known.
const judgedOf = (alarm) => (alarm.settled?.changes?.length ? alarm.settled.changes : changesOf(alarm));

// The words for the changes of new values, or an empty text.
export function describeChanges(settled) {
  const others = settled.others ? `, or ${words(settled.others)}` : "";
  const changes = (settled.changes ?? []).map((change) => `${words(change.parameter)} ${percent(change.relative)}`);
  return changes.length ? `the change is ${changes.join(" and ")}${others}` : "";
}

function settledOf(alarm) {
  const settled = judgedOf(alarm).flatMap((change) => {
    const found = alarm.settled?.parameters?.[change.parameter];
    return found ? [`${words(change.parameter)} ${withError(found.value, found.std)}${unitOf(change.unit)}`] : [];
  });
  const values = settled.length ? [`Now ${settled.join(", ")}.`] : [];
  const judged = alarm.settled ? describeChanges(alarm.settled) : "";
  return [...values, ...(judged ? [`By all samples since, ${judged}.`] : [])].join(" ") || null;
}

export function alarmCard(alarm, withAxis = true) {
  const known = !isOpen(alarm);
  const settled = settledOf(alarm);
  const button = el(
    "button",
    { type: "button", class: "strong", onclick: () => acknowledge(alarm), "aria-label": `Acknowledge the alarm of ${ownerOf(alarm)}` },
    "Acknowledge …",
  );
  return el(
    "li",
    { class: known ? "card known" : "card alarm", "data-alarm": alarm.number },
    icon(known ? "watching" : "alarm"),
    el(
      "div",
      { class: "card-text" },
      el(
        "p",
        { class: "card-title" },
        withAxis && alarm.axis ? el("a", { href: axisLink(alarm.axis) }, alarm.axis) : null,
        withAxis ? " " : null,
        el("strong", {}, causeOf(alarm)),
      ),
      known || !alarm.advice ? null : el("p", {}, `What to do: ${alarm.advice}`),
      known || alarm.silent ? null : el("p", {}, `How urgent: ${urgencyOf(alarm)}`),
      el("p", { class: "fine" }, sinceOf(alarm), settled ? ` ${settled}` : ""),
      alarm.silent ? null : el("p", { class: "fine" }, sureOf(alarm)),
      alarm.cleared === null ? null : el("p", { class: "fine" }, `back since ${wall(alarm.cleared)}`),
      alarm.acknowledged === null ? null : el("p", { class: "fine note-text" }, `acknowledged ${wall(alarm.acknowledged)}`, alarm.note ? `: “${alarm.note}”` : ""),
    ),
    known ? null : button,
  );
}

export const ownerOf = (alarm) => alarm.axis || `the ${alarm.silent} ${alarm.name}`;

export const axisLink = (name) => `#/axis/${encodeURIComponent(name)}`;

export function acknowledge(alarm) {
  const note = el("textarea", { id: "note", maxlength: "500", rows: "4" });
  askFirst(
    "Acknowledge the alarm",
    [
      el("p", {}, el("strong", {}, ownerOf(alarm)), `: ${causeOf(alarm)}`),
      el("label", { for: "note" }, "Note for those who come after you"),
      note,
    ],
    "Acknowledge",
    () => tell(`api/alarms/${alarm.number}/acknowledge`, { note: note.value }),
  );
}

// A dialog with one action, which also shows the reason if the action fails.
export function askFirst(title, content, action, act) {
  const problem = el("p", { role: "alert", class: "problem" });
  const dialog = el("dialog", { "aria-labelledby": "dialog-title" });
  const submit = async (event) => {
    event.preventDefault();
    try {
      await act();
      dialog.close();
    } catch (error) {
      problem.textContent = error instanceof Problem ? error.message : "the service does not answer; try again";
    }
  };
  const cancel = el("button", { type: "button", onclick: () => dialog.close() }, "Cancel");
  const buttons = el("div", { class: "buttons" }, cancel, el("button", { class: "strong" }, action));
  dialog.append(el("form", { onsubmit: submit }, el("h2", { id: "dialog-title" }, title), ...content, problem, buttons));
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
}
