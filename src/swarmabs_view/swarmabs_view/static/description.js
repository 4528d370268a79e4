// What the page shows of a parent system and its robots, by the description in the hello.

import { short } from "./drawing.js";
import { kindOf } from "./symbols.js";

const COLOURS = ["angle", "error", "torque", "inertia", "di", "si"];
const [STATE, ERROR, ABSTRACT] = [0, 1, 2]; // the first colour of each group of charts
const DASH = [8, 5];
const MARGIN = 0.002; // around the abstract state, in scales of a row, at least
const FIELDS = { coordinates: "", velocities: "rate of ", command: "command " }; // before the name of a coordinate
const ONLY = { velocities: "velocity", command: "command" }; // where there is only one coordinate

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
  const found = Object.fromEntries(["parent", "reference", "abstract", "desired", "further", "robot", "constant"].map((role) => [role, placed.filter((row) => row.role === role)]));
  found.followed = found.reference.map((wanted) => [found.parent.find(({ name }) => name === wanted.name), wanted]);
  found.others = found.parent.filter(({ name }) => !found.reference.some((wanted) => wanted.name === name));
  return found;
}

// The masses of the robots: 1 if the system has none, null where unknown.
export function massesOf({ robots, system }) {
  const place = roles(system).constant.findIndex(({ name }) => name === "mass");
  return robots.map(({ constants }) => (place < 0 ? 1 : constants[place] ?? null));
}

// The coordinates of a robot in words.
export function placeOf({ system }, { robots: { coordinates } }, robot) {
  const said = roles(system).robot.map(({ name, unit }, axis) => `${words(name)} ${short(coordinates[robot][axis], 4)}${unit ? ` ${unit}` : ""}`);
  return said.join(", ");
}

export function chartsOf(system) {
  const { followed, others, abstract, desired, further } = roles(system);
  const line = ({ name, of }, index) => ({ label: words(name), colour: COLOURS[index % COLOURS.length], of });
  const pair = (actual, wanted, label, index) => ({ title: titled(actual), lines: [line(actual, index), { label, colour: "reference", dash: DASH, of: wanted.of }] });
  const error = ([actual, wanted], index) => ({ ...line(actual, ERROR + index), label: `reference − ${words(actual.name)}`, of: (curves) => minus(wanted.of(curves), actual.of(curves)) });
  const units = [...new Set(others.map(({ unit }) => unit))].map((unit) => others.filter((one) => one.unit === unit));
  const charts = [
    ...followed.map(([actual, wanted]) => pair(actual, wanted, "reference", STATE)),
    ...(followed.length ? [{ title: united("tracking error", followed[0][0].unit), lines: followed.map(error) }] : []),
    ...units.map((rows) => ({ title: united(rows.map(({ name }) => words(name)).join(", "), rows[0].unit), lines: rows.map((row, index) => line(row, STATE + index)) })),
    ...abstract.map((actual, index) => pair(actual, desired[index], "desired", ABSTRACT + index)),
    ...further.map((row) => ({ title: titled(row), lines: [line(row, STATE)] })),
  ];
  return charts.map((chart, index) => ({ ...chart, place: `chart-${index}`, says: `${chart.title} over time` }));
}

// The rows of the abstract state to choose from: names, least margin and value shown, and where the values are.
export function rowsOf(system) {
  const { abstract, desired } = roles(system);
  return abstract.map(({ name, unit, scale, low, of }, index) => ({
    ...{ name: words(name), title: titled({ name, unit }), unit, margin: MARGIN * scale, least: low ?? -Infinity, curve: of },
    ...{ actual: (frame) => of(frame.values), wanted: (frame) => desired[index].of(frame.values) },
  }));
}

// The entries of "Now": id, label and value.
export function numbersOf(system) {
  const { parent, followed, others, abstract, desired, further } = roles(system);
  const entry = (label, row, number) => [`${row.role}-${number}`, `${label}${titled(row)}`, ({ frame }) => row.of(frame.values)];
  const goal = (actual, what) => united(followed.length > 1 ? `${words(actual.name)} ${what}` : what, actual.unit);
  return [
    ...followed.flatMap(([actual, wanted], number) => [
      entry("", actual, parent.indexOf(actual)),
      [`reference-${number}`, goal(actual, "reference"), ({ frame }) => wanted.of(frame.values)],
      [`error-${number}`, goal(actual, "error"), ({ frame }) => difference(wanted.of(frame.values), actual.of(frame.values))],
    ]),
    ...others.map((row) => entry("", row, parent.indexOf(row))),
    ...abstract.flatMap((row, number) => [entry("", row, number), entry("desired ", desired[number], number)]),
    ...further.map((row, number) => entry("", row, number)),
  ];
}

// The columns of the table of robots: constants of a robot, and fields of its state.
export function columnsOf({ robots, system }) {
  const { robot: coordinates, constant } = roles(system);
  const commands = (axis) => [...new Set(robots.map((robot) => kindOf(system, robot).commands[axis]))].join(" or ");
  const label = (field, name) => (coordinates.length > 1 ? undefined : ONLY[field]) ?? `${FIELDS[field]}${words(name)}`;
  const of = { coordinates: (unit) => unit, velocities: (unit) => `${unit}/s`, command: (_, axis) => commands(axis) };
  return {
    constants: constant.map((one, index) => [titled(one), (robot) => robot.constants[index] ?? null]),
    fields: Object.keys(FIELDS).flatMap((field) =>
      coordinates.map(({ name, unit }, index) => [`${field}-${index}`, united(label(field, name), of[field](unit, index)), (states, robot) => states[field][robot][index] ?? null]),
    ),
  };
}
