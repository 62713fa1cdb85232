// What the charts of an axis show: its estimates, then its signals.
import { number, unitOf, withError, words } from "./format.js";

const BAND = 2; // standard deviations

const plus = (values, std, times) => values.map((value, k) => (std[k] === null || value === null ? null : value + times * std[k]));

// Without a standard deviation nothing is known, whatever the number is.
function estimate(name, unit, j, level) {
  const part = (times) => (seen) => plus(seen[`theta${j}`], seen[`std${j}`], times);
  const told = (seen, k) => `${withError(seen[`theta${j}`][k] ?? NaN, seen[`std${j}`][k] ?? NaN)}${unitOf(unit)}`;
  const title = words(name);
  return { title, unit: `${unit ? unit + ", " : ""}± ${BAND} σ, dashed: nominal`, line: part(0), low: part(-BAND), high: part(BAND), level, told };
}

export function chartSpecs(group, nominal) {
  const speed = `${group.position_unit}/s`;
  const value = (name, unit) => (seen, k) => `${number(seen[name][k] ?? NaN)}${unitOf(unit)}`;
  return [
    ...group.names.map((name, j) => estimate(name, group.units[j], j, nominal[j])),
    {
      title: "input",
      unit: group.input_unit,
      line: (seen) => seen.u,
      low: (seen) => seen.low,
      high: (seen) => seen.high,
      steps: true,
      told: value("u", group.input_unit),
    },
    { title: "velocity", unit: `${speed}, mean between two points`, line: (seen) => seen.velocity, told: value("velocity", speed) },
    { title: "innovation", unit: "", line: (seen) => seen.innovation, level: 0, told: value("innovation", "") },
  ];
}
