// What is seen as CSV, every row of it rather than every point.
const quoted = (text) => (/[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
// A spreadsheet takes a cell that begins so for a formula.
const harmless = (text) => (/^[=+\-@\t\r]/.test(text) ? "'" + text : text);

export function csvOf(columns, group, states, from, to) {
  const unit = (name, of) => harmless(of ? `${name} [${of}]` : name);
  const { data } = columns;
  const heads = [unit("t", "s"), unit("u", group.input_unit), "counts"];
  const values = [data.time, data.u, data.counts];
  group.names.forEach((name, j) => {
    heads.push(unit(name, group.units[j]), unit(`${name}_std`, group.units[j]));
    values.push(data[`theta${j}`], data[`std${j}`]);
  });
  heads.push("innovation", "status", "state");
  values.push(data.innovation, data.status);
  const lines = [heads.map(quoted).join(",")];
  const [first, last] = [columns.find(from), columns.find(to)];
  for (let i = first; i < last; i++) {
    lines.push([...values.map((column) => (Number.isFinite(column[i]) ? column[i] : "")), states[data.state[i]]].join(","));
  }
  return lines.join("\n") + "\n";
}

export const fileName = (axis) => `${axis.replace(/[^\w.-]+/g, "_").slice(0, 80) || "axis"}.csv`;
