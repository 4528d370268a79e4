// Robots in the picture of any parent system: symbol or body, status, and id.
import { massesOf, placeOf } from "./description.js";
import { TEXT, font } from "./drawing.js";
import { kindColour, kindOf, outline } from "./symbols.js";
import { STATUS } from "./tables.js";

const NAMED = 24; // up to this number of robots, every robot has its id, beside it if it does not fit inside
const [LEAST, MOST] = [9, 16]; // px, size of an id inside a robot
const GAP = 3; // px between a robot and its id
const RINGS = 5; // distances at which an id is tried
const ANGLES = [-90, -60, -120, -30, -150, 0, 180, 30, 150, 60, 120, 90].map((degrees) => (degrees * Math.PI) / 180);
const PLACES = Array.from({ length: RINGS }, (_, ring) => ANGLES.map((angle) => ({ ring, angle }))).flat();

const overlaps = (one, other) => Math.abs(one.x - other.x) < one.w + other.w && Math.abs(one.y - other.y) < one.h + other.h;

// Draw the robots and return their places. `at` maps a position and the number of a robot to the screen; `bodyOf`
// returns the lines that draw a robot, px, the first one around its id, or null for the symbol of its kind. `ids`
// holds from frame to frame where the ids are.
export function drawRobots(surface, hello, frame, { at, bodyOf = () => null, lane, ids }) {
  const { context, unit } = surface;
  const { position, status } = frame.robots;
  const count = hello.robots.length;
  const masses = massesOf(hello).map((mass) => mass ?? 0);
  const mean = masses.reduce((sum, mass) => sum + mass, 0) / Math.max(count, 1) || 1;
  const usual = Math.min(Math.max(0.42 * lane, 4 * unit), 15 * unit);
  const spots = [];
  for (let index = count - 1; index >= 0; index -= 1) {
    if (position[index] === null || position[index] === undefined || status[index] === "left") {
      continue;
    }
    const size = Math.min(Math.max(usual * Math.sqrt(masses[index] / mean), 2.5 * unit), 26 * unit);
    const body = bodyOf(position[index], index);
    const box = body ? extent(body) : { ...point(at(position[index], index)), w: size, h: size };
    const kind = kindOf(hello.system, hello.robots[index]);
    trace(context, body, box, kind);
    paint(surface, box, kind, status[index]);
    const seat = body ? extent(body.slice(0, 1)) : box; // of the id
    spots.unshift({ ...box, seat, size: Math.max(box.w, box.h), index, status: status[index], text: said(hello, frame, index) });
  }
  name(surface, hello.robots, spots, ids);
  return spots;
}

// Name a robot with its status and coordinates.
function said(hello, frame, index) {
  return `robot ${hello.robots[index].id}: ${STATUS[frame.robots.status[index]] ?? "no data"}, ${placeOf(hello, frame, index)}`;
}

const point = ([x, y]) => ({ x, y });

// Centre and half the size of lines.
function extent(lines) {
  const [left, right, top, bottom] = [0, 1].flatMap((axis) => [Math.min, Math.max].map((most) => most(...lines.flat().map((place) => place[axis]))));
  return { x: (left + right) / 2, y: (top + bottom) / 2, w: (right - left) / 2, h: (bottom - top) / 2 };
}

// Make the path of a robot: its body, or the symbol of its kind.
function trace(context, body, { x, y, w: size }, kind) {
  context.beginPath();
  if (body) {
    body.forEach((line) => line.forEach((place, index) => (index ? context.lineTo(...place) : context.moveTo(...place))));
  } else {
    outline(context, kind, x, y, size);
  }
}

// Fill and outline the path of a robot by its status.
function paint({ context, colour, unit }, { x, y, w, h }, kind, status) {
  if (status === "active" || status === "limited") {
    context.fillStyle = kindColour(kind);
    context.fill();
    context.lineWidth = (status === "limited" ? 4 : 1) * unit;
    context.strokeStyle = status === "limited" ? colour.error : colour.ink;
    context.stroke();
  } else if (status === "dead") {
    context.fillStyle = colour.dead;
    context.fill();
    context.lineWidth = unit;
    context.strokeStyle = colour.dead;
    context.stroke();
    context.beginPath();
    context.moveTo(x - w, y - h);
    context.lineTo(x + w, y + h);
    context.moveTo(x + w, y - h);
    context.lineTo(x - w, y + h);
    context.lineWidth = 2 * unit;
    context.strokeStyle = colour.ink;
    context.stroke();
  } else if (status === "safe_stop") {
    context.fillStyle = colour.stop;
    context.fill();
    context.lineWidth = 3 * unit;
    context.strokeStyle = colour.outline;
    context.stroke();
  } else {
    context.fillStyle = colour.paper;
    context.fill();
    context.setLineDash([3 * unit, 2 * unit]);
    context.lineWidth = 2 * unit;
    context.strokeStyle = colour.grey;
    context.stroke();
    context.setLineDash([]);
  }
}

// Write the ids: inside a robot that has the room, else beside it, where it covers neither robots nor other ids.
function name(surface, robots, spots, ids) {
  const { context, unit } = surface;
  context.textAlign = "center";
  context.textBaseline = "middle";
  const beside = [];
  for (const spot of spots) {
    const text = String(robots[spot.index].id);
    const { seat } = spot;
    const size = Math.min(seat.w, 1.2 * seat.h, MOST * unit); // px
    context.font = font(size / TEXT, 600);
    const inside = { ...seat, w: context.measureText(text).width / 2, h: 0.4 * size };
    const free = size >= LEAST * unit && inside.w <= seat.w && !spots.some((other) => other !== spot && overlaps(inside, other.seat));
    if (free && (spot.status === "active" || spot.status === "limited")) {
      context.fillStyle = "#000000";
      context.fillText(text, seat.x, seat.y + 0.5);
    } else {
      beside.push({ spot, text });
    }
  }
  if (robots.length <= NAMED) {
    const taken = [...spots];
    for (const { spot, text } of beside) {
      taken.push(besides(surface, spot, text, taken, ids));
    }
  }
  context.textBaseline = "alphabetic";
}

// Write an id beside its robot, where it was before if that is still free; return its place.
function besides({ context, colour, unit, width, height }, spot, text, taken, ids) {
  context.font = font(unit, 600);
  const [w, h] = [context.measureText(text).width / 2 + 1, 6 * unit];
  const placed = ({ ring, angle }) => {
    const far = (size, own) => size + own + GAP * unit + 2 * ring * h;
    return { x: spot.x + Math.cos(angle) * far(spot.w, w), y: spot.y + Math.sin(angle) * far(spot.h, h), w, h };
  };
  const free = (choice) => {
    const box = placed(choice);
    const inside = box.x - w >= 0 && box.x + w <= width && box.y - h >= 0 && box.y + h <= height;
    return inside && !taken.some((other) => overlaps(box, other));
  };
  const before = ids.get(text);
  const choice = before && free(before) ? before : (PLACES.find(free) ?? PLACES[0]);
  ids.set(text, choice);
  const box = placed(choice);
  if (choice.ring) {
    context.beginPath();
    context.moveTo(spot.x, spot.y);
    context.lineTo(box.x - Math.cos(choice.angle) * w, box.y - Math.sin(choice.angle) * h);
    context.lineWidth = 1;
    context.strokeStyle = colour.quiet;
    context.stroke();
  }
  context.fillStyle = colour.ink;
  context.fillText(text, box.x, box.y + 0.5);
  return box;
}
