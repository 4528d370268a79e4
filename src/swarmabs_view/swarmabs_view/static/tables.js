// Numbers, robots, events and processes as text. Data from outside is always set as text, never as markup.
import { columnsOf, numbersOf, roles } from "./description.js";
import { short } from "./drawing.js";
import { kindOf } from "./symbols.js";

const ROBOTS_INTERVAL = 250; // ms
const FEW = 24; // largest number of robots whose table is open initially
const MOST_EVENTS = 1000;
const LONGEST_DETAIL = 200; // characters
export const STATUS = { active: "active", safe_stop: "safe stop", left: "left", dead: "dead", silent: "silent", limited: "limited" };
const BAD = new Set(["stopped", "zombie", "dead", "gone", "tracing-stop"]);

const element = (id) => document.getElementById(id);

// Notes below each table and list what is out of sight.
export class More {
  constructor() {
    const places = [...document.querySelectorAll(".scroll, .events")];
    this.pairs = places.map((place) => [place, place.nextElementSibling]);
    const sizes = new ResizeObserver(() => this.draw());
    for (const place of places) {
      place.addEventListener("scroll", () => this.draw());
      sizes.observe(place);
      new MutationObserver(() => this.draw()).observe(place, { childList: true, subtree: true });
    }
  }

  draw() {
    for (const [place, note] of this.pairs) {
      const below = place.scrollHeight - place.clientHeight - place.scrollTop > 2;
      const right = place.scrollWidth - place.clientWidth - place.scrollLeft > 2;
      const left = Number(place.dataset.leftOut ?? 0);
      const says = [below && "more rows below", right && "more columns to the right", left && `${left} earlier events not listed`];
      const text = says.filter(Boolean).join("; ");
      if (note.textContent !== text) {
        note.textContent = text;
      }
      note.hidden = !text;
    }
  }
}

// Show a number: exact in the element's value, rounded in its text.
function show(node, value, text) {
  node.value = value === null || value === undefined ? "" : String(value);
  node.textContent = text ?? short(value);
}

export function cell(row, tag = "td") {
  const node = document.createElement(tag);
  if (tag === "th") {
    node.scope = "row";
  }
  row.append(node);
  return node;
}

// The entries of "Now": id, label, value and, unless it is a rounded number, its text. `going` says whether steps
// follow each other, so that a rate exists.
const FIRST_NUMBERS = [
  ["step", "step", ({ frame }) => frame.step, String],
  ["time", "time, s", ({ frame }) => frame.time, (time) => time.toFixed(2)],
];
const LAST_NUMBERS = [
  ["step_rate", "steps per second", ({ frame, going }) => (going ? frame.step_rate : null), (rate) => rate?.toFixed(0) ?? "–"],
  [
    "following",
    "robots following",
    ({ frame }) => frame.robots.status.filter((status) => status === "active").length,
    (following, { hello }) => `${following} of ${hello.robots.length}`,
  ],
];

export class Numbers {
  hello({ system }) {
    this.entries = [...FIRST_NUMBERS, ...numbersOf(system), ...LAST_NUMBERS];
    const list = element("numbers");
    list.replaceChildren();
    for (const [id, label] of this.entries) {
      const [box, term, description, value] = ["div", "dt", "dd", "data"].map((tag) => document.createElement(tag));
      term.textContent = label;
      value.id = id;
      description.append(value);
      box.append(term, description);
      list.append(box);
    }
  }

  draw(hello, frame, going) {
    const now = { hello, frame, going };
    for (const [id, , of, text] of this.entries) {
      const value = of(now);
      show(element(id), value, text?.(value, now));
    }
  }
}

export class Robots {
  constructor() {
    this.body = element("robots").tBodies[0];
    this.details = element("robots-details");
    this.drawn = 0;
    this.details.addEventListener("toggle", () => {
      this.drawn = 0;
      this.again = true;
    });
  }

  hello(hello) {
    this.drawn = 0;
    const { constants, fields } = columnsOf(hello);
    this.fields = fields;
    const head = element("robots").tHead.rows[0];
    const labels = ["robot", "kind", "status", ...fields.map(([, label]) => label), ...constants.map(([label]) => label)];
    head.replaceChildren(...labels.map((label) => Object.assign(document.createElement("th"), { scope: "col", textContent: label })));
    this.body.replaceChildren();
    this.rows = hello.robots.map((robot) => {
      const row = this.body.insertRow();
      cell(row, "th").textContent = String(robot.id);
      cell(row).textContent = kindOf(hello.system, robot).words;
      const status = cell(row);
      const numbers = fields.map(([name]) => {
        const node = document.createElement("data");
        node.dataset.field = name;
        cell(row).append(node);
        return node;
      });
      for (const [, of] of constants) {
        const constant = document.createElement("data");
        show(constant, of(robot));
        cell(row).append(constant);
      }
      return { row, status, numbers };
    });
    element("robots-summary").textContent = `Table of all ${hello.robots.length} robots`;
    this.details.open = hello.robots.length <= FEW;
  }

  // The table is updated less often than the canvases, but always ends up with the latest frame.
  draw(now, frame) {
    this.again = false;
    if (!this.details.open || !this.rows) {
      return true;
    }
    if (now - this.drawn < ROBOTS_INTERVAL) {
      return false;
    }
    this.drawn = now;
    this.rows.forEach(({ row, status, numbers }, index) => {
      const found = frame.robots.status[index];
      status.textContent = found ? STATUS[found] : "no data";
      row.classList.toggle("bad", found !== "active");
      this.fields.forEach(([, , of], column) => show(numbers[column], of(frame.robots, index)));
    });
    return true;
  }
}

// The value of an event with its unit, if it has one: 0 is a value only where a setting returns to it.
function worth({ kind, value }, unit) {
  return value || (kind === "STEERING" && value === 0) ? `, ${short(value)}${unit ? ` ${unit}` : ""}` : "";
}

// The unit of all these, undefined if they differ.
function common(units) {
  return new Set(units).size === 1 ? units[0] : undefined;
}

function cut(text) {
  const characters = [...text];
  return characters.length > LONGEST_DETAIL ? `${characters.slice(0, LONGEST_DETAIL).join("")}…` : text;
}

export class Events {
  constructor() {
    this.list = element("events");
    this.commands = new Map(); // units, by robot
    this.leftOut = 0;
  }

  hello({ robots, system }) {
    this.commands = new Map(robots.map((robot) => [robot.id, common(kindOf(system, robot).commands)]));
  }

  take(message) {
    if (message.replace) {
      this.list.replaceChildren();
      this.leftOut = 0;
    }
    this.leftOut += message.left_out ?? 0;
    const made = message.events.map((event) => {
      const item = document.createElement("li");
      item.dataset.step = String(event.step);
      const what = document.createElement("b");
      what.textContent = event.words;
      const whom = event.agent ? `robot ${event.agent}, ` : "";
      item.append(`${event.time.toFixed(2)} s, step ${event.step}: ${whom}`, what, worth(event, event.unit === "command" ? this.commands.get(event.agent) : event.unit));
      if (event.detail && event.detail !== event.words) {
        const detail = document.createElement("bdi"); // isolates the writing direction of the text
        detail.textContent = cut(event.detail);
        if (detail.textContent !== event.detail) {
          detail.title = event.detail;
        }
        item.append(" – ", detail);
      }
      return item;
    });
    this.list.prepend(...made.reverse()); // the latest first
    while (this.list.children.length > MOST_EVENTS) {
      this.list.lastElementChild.remove();
      this.leftOut += 1;
    }
    this.list.dataset.leftOut = String(this.leftOut);
    this.list.hidden = !this.list.children.length;
    element("no-events").hidden = !this.list.hidden;
    this.shown = null;
  }

  // In a bag, mark the events after the step shown.
  draw(frame) {
    if (this.shown === frame.step) {
      return;
    }
    this.shown = frame.step;
    for (const item of this.list.children) {
      item.classList.toggle("future", Number(item.dataset.step) > frame.step);
    }
  }
}

export class Processes {
  constructor() {
    this.body = element("processes").tBodies[0];
  }

  take(message) {
    const { processes } = message;
    element("processes-scroll").hidden = !processes.length;
    element("no-processes").hidden = processes.length > 0;
    while (this.body.rows.length > processes.length) {
      this.body.deleteRow(-1);
    }
    while (this.body.rows.length < processes.length) {
      const row = this.body.insertRow();
      cell(row, "th");
      for (let index = 0; index < 4; index += 1) {
        cell(row);
      }
    }
    processes.forEach((one, index) => {
      const row = this.body.rows[index];
      const memory = one.memory === null ? "–" : (one.memory / 1e6).toFixed(0);
      const cpu = one.cpu === null ? "–" : one.cpu.toFixed(0);
      [one.name, one.pid, one.state, cpu, memory].forEach((text, column) => {
        row.cells[column].textContent = String(text);
      });
      row.classList.toggle("bad", BAD.has(one.state));
    });
  }
}

function lasting(seconds) {
  const [hours, minutes] = [Math.floor(seconds / 3600), Math.floor(seconds / 60) % 60];
  return hours ? `${hours} h ${minutes} min` : minutes ? `${minutes} min ${seconds % 60} s` : `${seconds} s`;
}

// Who leads and who stands by, of coordinators that have a standby.
export class Coordinators {
  take({ pairs }) {
    element("coordinators-panel").hidden = !pairs.length;
    const rows = pairs.map(({ name, primary, standby }) => {
      const row = document.createElement("tr");
      cell(row, "th").textContent = name.replaceAll("_", " ");
      for (const { role, seconds, ok } of [primary, standby]) {
        const place = cell(row);
        const text = document.createElement(role === "leads" ? "b" : "span");
        text.textContent = role;
        place.append(text, seconds === null ? "" : ` for ${lasting(seconds)}`);
        place.classList.toggle("bad", !ok);
      }
      return row;
    });
    element("coordinators").tBodies[0].replaceChildren(...rows);
  }
}
