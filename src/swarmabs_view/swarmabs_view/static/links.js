// Who hears whom, and how old the states are that each robot knows, where each robot sums up the swarm by itself.
import { cell } from "./tables.js";

const FEW = 20; // largest number of robots with labels, and rows of the table
const MOST_LACKED = 8; // ids in one cell
const RADIUS = 82; // of the circle, in the units of the viewBox

const element = (id) => document.getElementById(id);
const bad = ({ silent, majority }) => silent || !majority;

function shape(tag, attributes, title) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) {
    node.setAttribute(name, String(value));
  }
  if (title) {
    node.append(Object.assign(document.createElementNS(node.namespaceURI, "title"), { textContent: title }));
  }
  return node;
}

function words({ id, silent, hears, neighbours, majority }) {
  if (silent) {
    return `robot ${id} is silent`;
  }
  return `robot ${id} hears ${hears.length} of ${neighbours} neighbours${majority ? "" : ", a minority, so it stops"}`;
}

// The pairs of robots of which one hears the other: [one, other, whether both do].
function pairsOf(robots) {
  const heard = new Map(robots.map(({ id, hears }) => [id, new Set(hears)]));
  const pairs = [];
  for (const { id, hears } of robots) {
    for (const other of hears) {
      const both = heard.get(other)?.has(id);
      if (heard.has(other) && (id < other || !both)) {
        pairs.push([id, other, both]);
      }
    }
  }
  return pairs;
}

// The robots of the table: all, or of many those that are worst off, the worst first.
function listed(robots) {
  if (robots.length <= FEW) {
    return robots;
  }
  const worth = ({ silent, majority, lacks, neighbours, hears, oldest }) => [silent, !majority, lacks.length, neighbours - hears.length, oldest ?? -1].map(Number);
  const ranked = robots.map((robot) => [robot, worth(robot)]);
  ranked.sort(([, one], [, other]) => other.map((value, index) => value - one[index]).find((more) => more) ?? 0);
  return ranked.slice(0, FEW).map(([robot]) => robot);
}

function lacking(lacks) {
  const more = lacks.length - MOST_LACKED;
  return lacks.length ? `${lacks.slice(0, MOST_LACKED).join(", ")}${more > 0 ? ` and ${more} more` : ""}` : "–";
}

function aged(steps, period) {
  if (steps === null) {
    return "–";
  }
  const seconds = period ? `, ${(steps * period).toFixed(2)} s` : "";
  return `${steps} ${steps === 1 ? "step" : "steps"}${seconds}`;
}

export class Links {
  take({ robots }, period) {
    element("links-panel").hidden = !robots.length;
    this.table(robots, period);
    // Links change rarely, and there may be very many.
    const drawn = JSON.stringify(robots.map((robot) => [words(robot), robot.hears]));
    if (this.drawn !== drawn) {
      this.drawn = drawn;
      this.graph(robots);
    }
  }

  graph(robots) {
    const many = robots.length > FEW;
    const graph = element("links");
    graph.classList.toggle("many", many);
    const places = new Map(
      robots.map(({ id }, index) => {
        const turn = (2 * Math.PI * index) / robots.length;
        return [id, [Math.sin(turn), -Math.cos(turn)]];
      }),
    );
    const at = (id, radius = RADIUS) => places.get(id).map((part) => (radius * part).toFixed(1));
    const pairs = pairsOf(robots);
    const mutual = pairs.filter(([, , both]) => both);
    const single = pairs.filter(([, , both]) => !both);
    const lines = mutual.map(([one, other]) => `M${at(one)}L${at(other)}`).join("");
    const dashed = single.map(([one, other]) => {
      const [[x1, y1], [x2, y2]] = [at(one), at(other)];
      return shape("line", { class: "one", x1, y1, x2, y2 }, `robot ${one} hears robot ${other}, which does not hear it`);
    });
    // Many dots are small, but not those that are bad, which are on top of the others.
    const usual = Math.min(6, (2.4 * RADIUS) / robots.length);
    const dots = [...robots].sort((one, other) => bad(one) - bad(other)).map((robot) => {
      const [x, y] = at(robot.id);
      const size = bad(robot) ? Math.max(3.5, usual) : usual;
      const wide = 1.4 * size;
      return robot.majority || robot.silent
        ? shape("circle", { class: robot.silent ? "silent" : "follows", cx: x, cy: y, r: size }, words(robot))
        : shape("path", { class: "minority", d: `M${x} ${y}m0 ${-wide}l${wide} ${wide}l${-wide} ${wide}l${-wide} ${-wide}Z` }, words(robot));
    });
    const labels = (many ? [] : robots).map((robot) => {
      const [x, y] = at(robot.id, RADIUS + 15);
      const label = shape("text", { class: bad(robot) ? "bad" : "", x, y, dy: "0.35em" });
      label.append(String(robot.id));
      return label;
    });
    graph.replaceChildren(shape("path", { class: "both", d: lines }), ...dashed, ...dots, ...labels);
    const trouble = robots.filter(bad).slice(0, FEW).map(words);
    const said = [`of ${robots.length} robots, pairs that hear each other: ${mutual.length}`, `pairs of which only one hears the other: ${single.length}`, ...trouble];
    graph.setAttribute("aria-label", said.join("; "));
  }

  table(robots, period) {
    const shown = listed(robots);
    const rows = shown.map((robot) => {
      const row = document.createElement("tr");
      cell(row, "th").textContent = String(robot.id);
      const { silent, hears, neighbours, oldest, lacks, majority } = robot;
      const texts = silent
        ? ["is silent", "–", "–", "–"]
        : [`${hears.length} of ${neighbours}`, aged(oldest, period), lacking(lacks), majority ? "yes" : "no, it stops"];
      for (const text of texts) {
        cell(row).textContent = text;
      }
      row.classList.toggle("bad", bad(robot));
      return row;
    });
    element("linked").tBodies[0].replaceChildren(...rows);
    const more = robots.length - shown.length;
    element("links-left-out").hidden = !more;
    element("links-left-out").textContent = more ? `and ${more} more robots` : "";
  }
}
