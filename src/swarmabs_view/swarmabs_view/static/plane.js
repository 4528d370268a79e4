// The scene of the tilting plane in oblique view, with one lane per robot.
import { roles } from "./description.js";
import { font, short, ticks } from "./drawing.js";
import { kindColour } from "./symbols.js";
import { drawRobots } from "./robots.js";

export const SIDE = 0.36; // fraction of the picture's width from the axis to the end of the plane
export const PIVOT = 0.52; // fraction of the picture's height down to the axis
const BINS = 48;
const OTHER = "other"; // robots that do not follow
// Sizes in px, with texts of the usual size:
const LABELS = 40; // between two labels of the edge
const SUPPORT = 14; // half the foot of the support
const TOOTH = 5; // half the height of the teeth of a break line
const TEETH = 8; // of a break line
const DASHES = 1.04; // start of horizontal and reference, in half lengths from the middle of the edge

// A size to reserve space for: it changes only when it is too small or far too large.
function settled(held, needed) {
  return held >= needed && held <= 1.5 * needed ? held : 1.15 * needed;
}

// The height of a plane of length 1 at an angle, rad.
function rise(angle) {
  return Math.sin(Math.min(Math.abs(angle ?? 0), Math.PI / 2));
}

// The angle and its reference in a frame, rad, each null if unknown.
function angles({ system }, { values }) {
  return roles(system).followed[0].map((row) => row.of(values));
}

export class PlaneScene {
  whole = "plane"; // what the picture shows
  crowds = true; // whether many robots are shown by their density
  lever = true; // whether a push acts by the distance from the axis
  legend = ["reference"]; // entries that only some pictures have

  hello() {} // the scale outlives a change of the swarm

  // Half the length shown, m: of the plane, or of the swarm if chosen or if the plane is not known.
  halfLength(hello, frame, fit) {
    const far = Math.max(0, ...frame.robots.position.map((place) => Math.abs(place?.[0] ?? 0)));
    if (hello.plane && !fit) {
      return hello.plane.length / 2;
    }
    this.far = settled(this.far, Math.max(far, 0.02));
    return Math.min(this.far, hello.plane ? hello.plane.length / 2 : Infinity);
  }

  draw(surface, hello, frame, { fit, crowded, ids }) {
    const { context, width, height, colour, unit } = surface;
    const half = this.halfLength(hello, frame, fit);
    const [measured, wanted] = angles(hello, frame);
    const angle = measured ?? 0;
    this.rise = settled(this.rise, Math.max(rise(angle), rise(wanted), 0.01));
    const steep = Math.min(this.rise, 1);
    // The depth axis leans away from the rising side; otherwise a steep plane would appear edge-on.
    const deep = { x: (0.1 * Math.cos(angle) - 0.15 * Math.sin(angle)) * width, y: (0.4 - 0.15 * steep) * height };
    const scale = Math.min(SIDE * width, (0.4 * height - deep.y / 2) / steep) / half;
    const [cx, cy] = [0.5 * width, PIVOT * height];
    const along = { x: Math.cos(angle) * scale, y: -Math.sin(angle) * scale };
    // From metres along the plane and depth (0 near, 1 far) to the screen.
    const at = (p, d) => [cx + p * along.x + (d - 0.5) * deep.x, cy + p * along.y - (d - 0.5) * deep.y];
    const line = (...points) => {
      context.beginPath();
      points.forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
    };

    this.support(surface, at);
    this.level(surface, at, { half, scale, wanted });

    const cut = half < (hello.plane?.length ?? Infinity) / 2;
    // An end of the plane from near to far; where it is cut, a break line.
    const end = (p) => Array.from({ length: cut ? TEETH + 1 : 2 }, (_, index) => {
      const tooth = cut && index % TEETH ? (index % 2 ? 1 : -1) * TOOTH * unit : 0;
      return at(p + tooth / scale, index / (cut ? TEETH : 1));
    });
    line(...end(half), ...end(-half).reverse());
    context.closePath();
    context.fillStyle = colour.board;
    context.strokeStyle = colour.edge;
    context.lineWidth = unit;
    context.fill();
    context.stroke();
    context.lineWidth = 4 * unit;
    line(at(-half, 0), at(half, 0));
    context.stroke();

    const count = Math.max(hello.robots.length, 1);
    if (!crowded) {
      context.lineWidth = 1;
      context.strokeStyle = colour.lane;
      for (let index = 0; index < count; index += 1) {
        line(at(-half, (index + 0.5) / count), at(half, (index + 0.5) / count));
        context.stroke();
      }
    }
    context.lineWidth = 2 * unit;
    context.strokeStyle = colour.edge;
    line(at(0, 0), at(0, 1));
    context.stroke();

    context.fillStyle = colour.quiet;
    context.textAlign = "center";
    const below = (18 + 16 * Math.abs(Math.sin(angle))) * unit; // px from the edge
    const [middle, edge] = at(0, 0);
    const most = Math.min(6, (2 * half * scale) / (LABELS * unit));
    for (const p of ticks(-half, half, most).filter((one) => one !== 0)) {
      const [x, y] = at(p, 0);
      const [left, bottom] = [x + below * Math.sin(angle), y + below * Math.cos(angle)];
      const text = `${p} m`;
      const [aside, broad] = [Math.abs(left - middle), context.measureText(text).width / 2];
      // A label outside the support and inside the circle without dashes overlaps neither.
      if (aside - broad > SUPPORT * unit && Math.hypot(aside + broad, bottom - edge) < DASHES * half * scale) {
        context.fillText(text, left, bottom);
      }
    }
    const section = hello.plane ? `section: ${short(2 * half, 2)} m of ${short(hello.plane.length, 3)} m` : "section: the length of the plane is not known";
    const notes = cut ? [section] : [];
    // A robot is drawn where its mass is, so at its height above the lane.
    const place = ([p], index) => {
      const [[x, y], above] = [at(p, (index + 0.5) / count), hello.plane?.heights[hello.robots[index].id] ?? 0];
      return [x - above * scale * Math.sin(angle), y - above * scale * Math.cos(angle)];
    };
    const spots = crowded
      ? this.density(surface, hello, frame, at, half, deep.y, notes)
      : drawRobots(surface, hello, frame, { at: place, lane: deep.y / count, ids });
    context.font = font(unit);
    context.textAlign = "left";
    notes.forEach((note, index) => {
      context.fillStyle = index || !cut ? colour.quiet : colour.ink;
      context.fillText(note, 6, (14 + 15 * index) * unit);
    });
    return spots;
  }

  support({ context, colour, height, unit }, at) {
    context.fillStyle = colour.grey;
    const [x, y] = at(0, 0);
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + SUPPORT * unit, y + 0.16 * height);
    context.lineTo(x - SUPPORT * unit, y + 0.16 * height);
    context.fill();
  }

  // The horizontal and the reference, on both sides of the near edge, which has the labels below it.
  level({ context, colour, unit }, at, { half, scale, wanted }) {
    const [x, y] = at(0, 0);
    const dashes = (angle) => {
      context.beginPath();
      for (const side of [-1, 1]) {
        const along = [side * Math.cos(angle) * half * scale, -side * Math.sin(angle) * half * scale];
        context.moveTo(x + DASHES * along[0], y + DASHES * along[1]);
        context.lineTo(x + 1.24 * along[0], y + 1.24 * along[1]);
      }
      context.stroke();
    };
    context.setLineDash([3 * unit, 4 * unit]);
    context.lineWidth = unit;
    context.strokeStyle = colour.quiet;
    dashes(0);
    if (wanted !== null) {
      context.setLineDash([9 * unit, 5 * unit]);
      context.lineWidth = 2.5 * unit;
      context.strokeStyle = colour.reference;
      dashes(wanted);
    }
    context.setLineDash([]);
  }

  // The number of robots per interval, as bars along the plane: by kind, and those that do not follow. Adds what a bar
  // is to the notes.
  density({ context, colour, unit }, hello, frame, at, half, height, notes) {
    const kinds = hello.system.kinds.map((kind) => ({ name: kind.name, words: kind.legend, fill: kindColour(kind) }));
    const groups = [...kinds, { name: OTHER, words: "not following", fill: colour.dead }];
    const bins = Array.from({ length: BINS }, () => Object.fromEntries(groups.map(({ name }) => [name, 0])));
    hello.robots.forEach((robot, index) => {
      const status = frame.robots.status[index];
      if (!frame.robots.position[index] || status === "left") {
        return;
      }
      const [position] = frame.robots.position[index];
      const bin = Math.min(Math.max(Math.floor(((position + half) / (2 * half)) * BINS), 0), BINS - 1);
      bins[bin][status === "active" ? robot.kind : OTHER] += 1;
    });
    const most = Math.max(1, ...bins.map((bin) => Object.values(bin).reduce((sum, count) => sum + count)));
    const bar = Math.min(height / most, 12 * unit); // px of a robot
    const spots = [];
    bins.forEach((bin, index) => {
      const [from, to] = [index, index + 1].map((one) => -half + (one * 2 * half) / BINS);
      const [x0, y0] = at(from, 0.5);
      const [x1, y1] = at(to, 0.5);
      let up = 0;
      for (const { name, fill } of groups.filter((group) => bin[group.name])) {
        const top = up + bin[name] * bar;
        context.beginPath();
        [[x0, y0 - up], [x1, y1 - up], [x1, y1 - top], [x0, y0 - top]].forEach((point) => context.lineTo(...point));
        context.closePath();
        context.fillStyle = fill;
        context.fill();
        context.lineWidth = 1;
        context.strokeStyle = colour.board;
        context.stroke();
        up = top;
      }
      if (up) {
        const counts = groups.filter(({ name }) => bin[name]).map(({ name, words }) => `${bin[name]} ${words}`);
        const said = `${short(from, 2)} to ${short(to, 2)} m: ${counts.join(", ")}`;
        spots.push({ x: (x0 + x1) / 2, y: (y0 + y1) / 2 - up / 2, size: up / 2, text: said });
      }
    });
    notes.push(`robots per ${short((2 * half) / BINS, 2)} m; highest bar: ${most}`);
    return spots;
  }

  describe(hello, frame) {
    const [angle] = angles(hello, frame);
    const degrees = ((angle ?? 0) * 180) / Math.PI;
    return `The plane at ${short(frame.time, 4)} s: angle ${short(angle, 4)} rad, which is ${short(degrees, 3)} degrees`;
  }
}
