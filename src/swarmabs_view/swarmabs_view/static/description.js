// What the page shows of a parent system other than the plane, by the description in the message "system".

import { KINDS } from "./kinds.js";

const COLOURS = ["angle", "error", "torque", "inertia", "di", "si"];
const DASH = [8, 5];
const MARGIN = 0.002; // around the abstract state, in scales of a row, at least
const FIELDS = { coordinates: "", velocities: "rate of ", command: "command " };

const words = (name) => name.replaceAll("_", " ");
export const united = (text, unit) => [text, unit.replaceAll("^2", "²").replaceAll("^3", "³")].filter((one) => one && one !== "1").join(", ");
export const capital = (name) => name[0].toUpperCase() + words(name).slice(1);
export const titled = ({ name, unit }) => united(words(name), unit);
export const minus = (wanted, actual) => wanted.map((one, index) => difference(one, actual[index]));

export function difference(wanted, actual) {
  return wanted === null || actual === null ? null : wanted - actual;
}

// The numbers by their role, each with its place in frames and curves.
export function roles({ rows }) {
  const placed = rows.map((row, index) => ({ ...row, index, of: (values) => values[index] }));
  const found = Object.fromEntries(["parent", "reference", "abstract", "desired", "robot", "constant"].map((role) => [role, placed.filter((row) => row.role === role)]));
  found.followed = found.reference.map((wanted) => [found.parent.find(({ name }) => name === wanted.name), wanted]);
  found.others = found.parent.filter(({ name }) => !found.reference.some((wanted) => wanted.name === name));
  return found;
}

export function systemCharts(system) {
  const { followed, others, abstract, desired } = roles(system);
  const line = ({ name, of }, index) => ({ label: words(name), colour: COLOURS[index % COLOURS.length], of });
  const pair = (actual, wanted, label) => ({ title: titled(actual), lines: [line(actual, 0), { label, colour: "reference", dash: DASH, of: wanted.of }] });
  const error = ([actual, wanted], index) => ({ ...line(actual, index), label: `reference − ${words(actual.name)}`, of: (curves) => minus(wanted.of(curves), actual.of(curves)) });
  const units = [...new Set(others.map(({ unit }) => unit))].map((unit) => others.filter((one) => one.unit === unit));
  const charts = [
    ...followed.map(([actual, wanted]) => pair(actual, wanted, "reference")),
    ...(followed.length ? [{ title: united("tracking error", followed[0][0].unit), lines: followed.map(error) }] : []),
    ...units.map((rows) => ({ title: united(rows.map(({ name }) => words(name)).join(", "), rows[0].unit), lines: rows.map(line) })),
    ...abstract.map((actual, index) => pair(actual, desired[index], "desired")),
  ];
  return charts.map((chart, index) => ({ ...chart, place: `chart-${index}`, says: `${chart.title} over time` }));
}

// The rows of the abstract state, as `PLANE_ROWS` of the plane.
export function systemRows(system) {
  const { abstract, desired } = roles(system);
  return abstract.map(({ name, unit, scale, of }, index) => ({
    ...{ name: words(name), title: titled({ name, unit }), unit, margin: MARGIN * scale, least: -Infinity, curve: of },
    ...{ actual: (frame) => of(frame.values), wanted: (frame) => desired[index].of(frame.values) },
  }));
}

// The entries of "Now", as `PLANE_NUMBERS` of the plane.
export function systemNumbers(system) {
  const { parent, followed, abstract, desired } = roles(system);
  const entry = (label, row) => [`${row.role}-${row.index}`, `${label}${titled(row)}`, ({ frame }) => row.of(frame.values)];
  return [
    ...parent.map((row) => entry("", row)),
    ...followed.flatMap(([actual, wanted], index) => [
      [`reference-${index}`, united(`${words(actual.name)} reference`, actual.unit), ({ frame }) => wanted.of(frame.values)],
      [`error-${index}`, united(`${words(actual.name)} error`, actual.unit), ({ frame }) => difference(wanted.of(frame.values), actual.of(frame.values))],
    ]),
    ...abstract.flatMap((row, index) => [entry("", row), entry("desired ", desired[index])]),
  ];
}

// The columns of the table of robots: constants of a robot, and fields of its state.
export function systemColumns({ robots, system }) {
  const { robot: coordinates, constant } = roles(system);
  const units = (unit) => [...new Set(robots.map(({ kind }) => KINDS[kind].command(unit)))].join(" or ");
  const of = { coordinates: (unit) => unit, velocities: (unit) => `${unit}/s`, command: units };
  return {
    constants: constant.map((one, index) => [titled(one), (_, robot) => system.constants[robot]?.[index] ?? null]),
    fields: Object.keys(FIELDS).flatMap((field) =>
      coordinates.map(({ name, unit }, index) => [`${field}-${index}`, united(`${FIELDS[field]}${words(name)}`, of[field](unit)), (states, robot) => states[field][robot][index] ?? null]),
    ),
  };
}
