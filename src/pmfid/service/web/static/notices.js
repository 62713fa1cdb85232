// Events in one line each.
import { el } from "./dom.js";
import { wall } from "./format.js";

export const noticeLine = (notice) =>
  el("li", {}, el("time", {}, wall(notice.wall)), " ", el("strong", {}, notice.axis || "service"), ` ${notice.text}`);
