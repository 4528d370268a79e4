// The page: receives the messages of the server and draws the latest data once per animation frame.
import { AbstractView } from "./abstract.js";
import { Charts } from "./charts.js";
import { Connection, VERSION } from "./connection.js";
import { Controls } from "./controls.js";
import { capital, massesOf } from "./description.js";
import { Links } from "./links.js";
import { Picture } from "./picture.js";
import { SteeringPanel } from "./steering.js";
import { legend } from "./symbols.js";
import { Coordinators, Events, More, Numbers, Processes, Robots } from "./tables.js";

const element = (id) => document.getElementById(id);

let hello = null;
let frame = null;
let state = { phase: "waiting", playing: null, speed: null };
let dirty = false;
let before = null; // what was shown when the connection was lost

const plane = new Picture(element("plane"));
const abstract = new AbstractView(element("abstract"), redraw);
const numbers = new Numbers();
const robots = new Robots();
const events = new Events();
const processes = new Processes();
const coordinators = new Coordinators();
const links = new Links();
const connection = new Connection(take, shown);
const controls = new Controls((message) => connection.send(message));
const steering = new SteeringPanel((message) => connection.send(message), status);
const charts = new Charts((time) => controls.seekTime(time));
new More();

function status(robot) {
  return frame?.robots.status[hello.robots.findIndex(({ id }) => id === robot)];
}

function take(message) {
  if (message.type === "hello") {
    greet(message);
  } else if (message.type === "frame") {
    frame = message;
    controls.frame(message);
    dirty = true;
  } else if (message.type === "sets") {
    hello.regions = message.regions;
    dirty = true;
  } else if (message.type === "curves") {
    charts.take(message);
    dirty = true;
  } else if (message.type === "positions") {
    charts.takePositions(message);
    dirty = true;
  } else if (message.type === "events") {
    events.take(message);
    charts.takeEvents(message);
    dirty = true;
  } else if (message.type === "health") {
    processes.take(message);
  } else if (message.type === "coordinators") {
    coordinators.take(message);
  } else if (message.type === "links") {
    links.take(message, hello.period);
  } else if (message.type === "steering") {
    steering.take(message);
  } else if (message.type === "answer") {
    steering.answer(message);
  } else if (message.type === "state") {
    state = message;
    dirty = true;
    controls.state(message);
    badge(message.phase, message.text);
  }
}

function greet(message) {
  const same = before && hello && before.place === message.place && message.playback;
  hello = message;
  frame = same ? frame : null;
  known();
  element("title").textContent = message.title;
  element("place").textContent = message.place;
  document.title = `${message.title} – swarmabs view`;
  controls.hello(message);
  steering.hello(message);
  describe();
  element("processes-panel").hidden = message.source === "bag";
  processes.take({ processes: [] });
  coordinators.take({ pairs: [] });
  links.take({ robots: [] });
  if (same) {
    controls.resume(before);
  }
  before = null;
  controls.follow();
}

// Adapt all parts to the parent system and its robots.
function describe() {
  const { system } = hello;
  const scene = plane.scene(hello);
  for (const part of [events, numbers, robots, charts, abstract, plane]) {
    part.hello(hello);
  }
  steering.describe(system, scene.lever);
  fitted(plane.crowded(hello));
  element("plane-title").textContent = `${capital(system.name)} and robots`;
  element("plane-panel").toggleAttribute("data-axes", scene === plane.usual);
  element("zoom").hidden = !hello.manifold;
  const crowded = plane.crowded(hello);
  const shown = { each: !crowded, crowd: crowded, sets: Boolean(hello.manifold) };
  for (const entry of ["limited", "reference"]) {
    shown[entry] = scene.legend.includes(entry);
  }
  for (const [group, visible] of Object.entries(shown)) {
    document.querySelectorAll(`.legend li.${group}`).forEach((item) => {
      item.hidden = !visible;
    });
  }
  kinds();
}

// The legend of the kinds of robots, in the colours of the theme.
function kinds() {
  if (hello) {
    document.querySelectorAll(".legend li.kind").forEach((item) => item.remove());
    document.querySelector("#plane-panel .legend").prepend(...legend(hello));
  }
}

// What is drawn is that of another run until the first frame of this one.
function known() {
  document.body.classList.toggle("unknown", !frame);
}

function badge(phase, text) {
  const node = element("state");
  node.dataset.phase = phase;
  const shownText = phase === text || !text ? phase : `${phase}: ${text}`;
  if (node.textContent !== shownText) {
    node.textContent = shownText;
  }
}

const LOST = "Connection lost; reconnecting. The page shows the last data received.";
const FULL = "Too many pages are connected. This page connects as soon as another one is closed; trying again.";

function shown(status, version) {
  const lost = status !== "open";
  document.body.classList.toggle("lost", lost);
  const banner = element("lost");
  if (lost && hello && frame && !before) {
    // The requested step, even if its frame has not arrived.
    before = { place: hello.place, step: controls.step, playing: state.playing, speed: state.speed ?? 1 };
  }
  controls.connected(!lost);
  steering.connected(!lost, status === "refused");
  if (lost) {
    const other = `The program uses protocol version ${version}, this page version ${VERSION}: reload the page.`;
    const text = { full: FULL, other }[status] ?? LOST;
    if (banner.hidden || banner.textContent !== text) {
      banner.textContent = text;
    }
    if (steering.restarting) {
      badge("waiting", "the next run is starting");
    } else {
      badge("lost", status === "full" ? "too many pages" : "no connection");
    }
  }
  banner.hidden = !lost || steering.restarting;
}

function draw(now) {
  requestAnimationFrame(draw);
  if (!hello || !frame || (!dirty && !robots.again && !charts.stale)) {
    return;
  }
  known();
  numbers.draw(hello, frame, state.playing ?? state.phase === "running");
  events.draw(frame);
  plane.draw(hello, frame);
  abstract.draw(hello, frame, charts.curves);
  charts.draw(now, frame.time);
  dirty = !robots.draw(now, frame);
}

function redraw() {
  dirty = true;
}

function zoom() {
  abstract.near = !abstract.near;
  const button = element("zoom");
  button.setAttribute("aria-pressed", String(!abstract.near));
  button.textContent = abstract.near ? "Show whole" : "Zoom in";
  redraw();
}

function fitted(fit) {
  plane.fit = fit;
  const button = element("fit");
  button.setAttribute("aria-pressed", String(fit));
  button.textContent = fit ? `Whole ${plane.scene(hello).whole}` : "Fit to swarm";
  const masses = new Set(massesOf(hello).filter((mass, robot) => mass && !hello.robots[robot].body.length));
  const sized = masses.size > 1 ? "area proportional to mass" : "";
  element("drawn").textContent = plane.crowded(hello) ? "bars: robots per interval" : sized;
  redraw();
}

function fit() {
  if (hello) {
    fitted(!plane.fit);
  }
}

const { theme, layout } = window.swarmabsAppearance;

function shownTheme() {
  element("theme").textContent = `Theme: ${theme.chosen}`;
}

function shownLayout() {
  element("layout").textContent = layout.chosen === "presenter" ? "Full page" : "Presenter";
}

function nextTheme() {
  theme.next();
  shownTheme();
}

function nextLayout() {
  layout.next();
  shownLayout();
}

function help() {
  const keys = element("keys");
  keys.hidden = !keys.hidden;
  element("help").setAttribute("aria-expanded", String(!keys.hidden));
}

shownTheme();
shownLayout();
element("theme").addEventListener("click", nextTheme);
element("layout").addEventListener("click", nextLayout);
element("zoom").addEventListener("click", zoom);
element("fit").addEventListener("click", fit);
element("help").addEventListener("click", help);
window.addEventListener("appearancechange", () => {
  kinds();
  redraw();
});
window.addEventListener("resize", redraw);
const resized = new ResizeObserver(redraw);
resized.observe(element("plane"));
resized.observe(element("abstract"));
document.addEventListener("keydown", (event) => {
  const typing = event.target instanceof HTMLInputElement && event.target.type !== "range";
  if (typing || event.target instanceof HTMLSelectElement || event.ctrlKey || event.altKey || event.metaKey) {
    return;
  }
  ({ t: nextTheme, p: nextLayout, z: zoom, f: fit, "?": help })[event.key.toLowerCase()]?.();
});
requestAnimationFrame(draw);
