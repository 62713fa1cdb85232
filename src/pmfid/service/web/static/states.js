// What an axis is, in the order in which it needs someone; each with a word and a shape, never a colour alone.
import { svg } from "./dom.js";

export const KINDS = ["alarm", "silent", "suspicious", "cannot-tell", "settling", "starting", "watching"];

export const WORD = {
  alarm: "Alarm",
  silent: "No data",
  suspicious: "Suspicious",
  "cannot-tell": "Cannot tell",
  settling: "Settling",
  starting: "Starting",
  watching: "Watching",
};

export const MEANING = {
  alarm: "a parameter changed, and nobody has acknowledged it",
  silent: "no data arrive",
  suspicious: "a change begins to show, and its cause is not clear yet",
  "cannot-tell": "the motion is too small or too uniform to show a change",
  settling: "a parameter changed, and the monitor measures its new value",
  starting: "no estimate exists yet",
  watching: "no parameter has changed",
};

const SHAPES = {
  alarm: ["M8 1 15.5 14.5H.5Z", true],
  silent: ["M3 3l10 10M13 3 3 13", false],
  suspicious: ["M8 1l7 7-7 7-7-7Z", true],
  "cannot-tell": ["M8 2a6 6 0 1 0 .01 0M5 8h6", false],
  settling: ["M8 2a6 6 0 1 0 .01 0M8 2v12M11 3.2v9.6", false],
  starting: ["M3 8h.01M8 8h.01M13 8h.01", false],
  watching: ["M3 8.5l3.5 3.5L13 4.5", false],
};

export function icon(kind) {
  const [path, filled] = SHAPES[kind];
  const shape = svg("path", { d: path, class: filled ? "filled" : "drawn" });
  return svg("svg", { viewBox: "0 0 16 16", class: "icon", "aria-hidden": "true" }, shape);
}
