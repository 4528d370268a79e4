// The tilting plane in oblique view, with one lane per robot.
import { colours, prepared, short, ticks } from "./drawing.js";
import { KINDS, outline } from "./kinds.js";
import { STATUS } from "./tables.js";

const CROWD = 60; // above this number of robots, draw their density
const BINS = 48;
const NEAR = 5; // px around a robot within which the pointer selects it

const LABELS = 40; // px between two labels of the edge
const SUPPORT = 14; // px, half the foot of the support
const DASHES = 1.04; // start of horizontal and reference, in half lengths from the middle of the edge

// A size to reserve space for: it changes only when it is too small or far too large.
function settled(held, needed) {
  return held >= needed && held <= 1.5 * needed ? held : 1.15 * needed;
}

// The height of a plane of length 1 at an angle, rad.
function rise(angle) {
  return Math.sin(Math.min(Math.abs(angle ?? 0), Math.PI / 2));
}

export class PlaneView {
  constructor(canvas) {
    this.canvas = canvas;
    this.label = document.getElementById("pointed");
    this.pointer = null;
    this.spots = []; // places of the robots drawn
    this.described = -Infinity; // when, ms
    this.fit = false; // whether the scale follows the swarm, not the plane
    for (const kind of ["pointermove", "pointerdown"]) {
      canvas.addEventListener(kind, (event) => this.point({ x: event.offsetX, y: event.offsetY }));
    }
    canvas.addEventListener("pointerleave", () => this.point(null));
  }

  crowded(hello) {
    return hello.robots.length > CROWD;
  }

  // Half the length shown, m: of the plane, or of the swarm if chosen or if the plane is not known.
  halfLength(hello, frame) {
    const far = Math.max(0, ...frame.robots.position.map((p) => Math.abs(p ?? 0)));
    if (hello.plane && !this.fit) {
      return hello.plane.length / 2;
    }
    this.far = settled(this.far, Math.max(far, 0.02));
    return Math.min(this.far, hello.plane ? hello.plane.length / 2 : Infinity);
  }

  draw(hello, frame) {
    const { context, width, height } = prepared(this.canvas);
    const colour = colours();
    const half = this.halfLength(hello, frame);
    const angle = frame.angle ?? 0;
    this.rise = settled(this.rise, Math.max(rise(angle), rise(frame.reference), 0.01));
    const steep = Math.min(this.rise, 1);
    // The depth axis leans away from the rising side; otherwise a steep plane would appear edge-on.
    const deep = { x: (0.1 * Math.cos(angle) - 0.15 * Math.sin(angle)) * width, y: (0.4 - 0.15 * steep) * height };
    const crowded = this.crowded(hello);
    const scale = Math.min(0.36 * width, (0.4 * height - deep.y / 2) / steep) / half;
    const [cx, cy] = [0.5 * width, 0.52 * height];
    const along = { x: Math.cos(angle) * scale, y: -Math.sin(angle) * scale };
    // From metres along the plane and depth (0 near, 1 far) to the screen.
    const at = (p, d) => [cx + p * along.x + (d - 0.5) * deep.x, cy + p * along.y - (d - 0.5) * deep.y];
    const line = (...points) => {
      context.beginPath();
      points.forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
    };

    this.support(context, at, colour, height);
    this.level(context, at, colour, { half, scale, wanted: frame.reference });

    line(at(-half, 0), at(half, 0), at(half, 1), at(-half, 1));
    context.closePath();
    context.fillStyle = colour.board;
    context.strokeStyle = colour.edge;
    context.lineWidth = 1;
    context.fill();
    context.stroke();
    context.lineWidth = 4;
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
    context.lineWidth = 2;
    context.strokeStyle = colour.edge;
    line(at(0, 0), at(0, 1));
    context.stroke();

    context.fillStyle = colour.quiet;
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "center";
    const below = 18 + 16 * Math.abs(Math.sin(angle)); // px from the edge
    const [middle, edge] = at(0, 0);
    for (const p of ticks(-half, half, Math.min(6, (2 * half * scale) / LABELS)).filter((one) => one !== 0)) {
      const [x, y] = at(p, 0);
      const [left, bottom] = [x + below * Math.sin(angle), y + below * Math.cos(angle)];
      const text = `${p} m`;
      const [aside, broad] = [Math.abs(left - middle), context.measureText(text).width / 2];
      // A label outside the support and inside the circle without dashes overlaps neither.
      if (aside - broad > SUPPORT && Math.hypot(aside + broad, bottom - edge) < DASHES * half * scale) {
        context.fillText(text, left, bottom);
      }
    }

    if (crowded) {
      this.density(context, hello, frame, at, colour, half, deep.y);
    } else {
      this.robots(context, hello, frame, at, colour, deep.y / count);
    }
    this.tell();
    this.describe(hello, frame);
  }

  support(context, at, colour, height) {
    context.fillStyle = colour.grey;
    const [x, y] = at(0, 0);
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + SUPPORT, y + 0.16 * height);
    context.lineTo(x - SUPPORT, y + 0.16 * height);
    context.fill();
  }

  // The horizontal and the reference, on both sides of the near edge, which has the labels below it.
  level(context, at, colour, { half, scale, wanted }) {
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
    context.setLineDash([3, 4]);
    context.lineWidth = 1;
    context.strokeStyle = colour.quiet;
    dashes(0);
    if (wanted !== null) {
      context.setLineDash([9, 5]);
      context.lineWidth = 2.5;
      context.strokeStyle = colour.reference;
      dashes(wanted);
    }
    context.setLineDash([]);
  }

  // The number of robots per interval, as bars along the plane: by kind, and those that do not follow.
  density(context, hello, frame, at, colour, half, height) {
    const groups = ["si", "di", "other"];
    const words = { si: "velocity-driven", di: "force-driven", other: "not following" };
    const bins = Array.from({ length: BINS }, () => ({ si: 0, di: 0, other: 0 }));
    hello.robots.forEach((robot, index) => {
      const position = frame.robots.position[index];
      const status = frame.robots.status[index];
      if (position === null || position === undefined || status === "left") {
        return;
      }
      const bin = Math.min(Math.max(Math.floor(((position + half) / (2 * half)) * BINS), 0), BINS - 1);
      const kind = KINDS[robot.kind].colour;
      bins[bin][status === "active" ? kind : "other"] += 1;
    });
    const most = Math.max(1, ...bins.map((bin) => bin.si + bin.di + bin.other));
    const unit = Math.min(height / most, 12);
    this.spots = [];
    bins.forEach((bin, index) => {
      const [from, to] = [index, index + 1].map((one) => -half + (one * 2 * half) / BINS);
      const [x0, y0] = at(from, 0.5);
      const [x1, y1] = at(to, 0.5);
      let up = 0;
      for (const group of groups.filter((one) => bin[one])) {
        const top = up + bin[group] * unit;
        context.beginPath();
        [[x0, y0 - up], [x1, y1 - up], [x1, y1 - top], [x0, y0 - top]].forEach((point) => context.lineTo(...point));
        context.closePath();
        context.fillStyle = group === "other" ? colour.dead : colour[group];
        context.fill();
        context.lineWidth = 1;
        context.strokeStyle = colour.board;
        context.stroke();
        up = top;
      }
      if (up) {
        const said = groups.filter((one) => bin[one]).map((one) => `${bin[one]} ${words[one]}`);
        const text = `${short(from, 2)} to ${short(to, 2)} m: ${said.join(", ")}`;
        this.spots.push({ x: (x0 + x1) / 2, y: (y0 + y1) / 2 - up / 2, size: up / 2, text });
      }
    });
    context.fillStyle = colour.quiet;
    context.textAlign = "left";
    context.fillText(`robots per ${short((2 * half) / BINS, 2)} m; highest bar: ${most}`, 6, 14);
  }

  robots(context, hello, frame, at, colour, lane) {
    const { position, status } = frame.robots;
    const count = hello.robots.length;
    const masses = hello.robots.map((robot) => robot.mass ?? (hello.system ? 1 : 0));
    const mean = masses.reduce((sum, mass) => sum + mass, 0) / Math.max(count, 1) || 1;
    const usual = Math.min(Math.max(0.42 * lane, 4), 15);
    context.textBaseline = "middle";
    this.spots = [];
    for (let index = count - 1; index >= 0; index -= 1) {
      if (position[index] === null || position[index] === undefined || status[index] === "left") {
        continue;
      }
      const [x, y] = at(position[index], (index + 0.5) / count);
      const size = Math.min(Math.max(usual * Math.sqrt(masses[index] / mean), 2.5), 26);
      this.robot(context, x, y, size, hello.robots[index].kind, status[index], colour);
      this.spots.push({ x, y, size, text: this.said(hello, frame, index) });
      if (size >= 9 && status[index] === "active") {
        context.fillStyle = "#000000";
        context.font = `600 ${Math.round(size)}px system-ui, sans-serif`;
        context.fillText(String(hello.robots[index].id), x, y + 0.5);
      }
    }
    context.textBaseline = "alphabetic";
  }

  // Name a robot with its status and position.
  said(hello, { robots: { position, status } }, index) {
    return `robot ${hello.robots[index].id}: ${STATUS[status[index]] ?? "no data"}, ${short(position[index], 4)} m`;
  }

  robot(context, x, y, size, kind, status, colour) {
    context.beginPath();
    outline(context, kind, x, y, size);
    if (status === "active" || status === "limited") {
      context.fillStyle = colour[KINDS[kind].colour];
      context.fill();
      context.lineWidth = status === "limited" ? 4 : 1;
      context.strokeStyle = status === "limited" ? colour.error : colour.ink;
      context.stroke();
    } else if (status === "dead") {
      context.fillStyle = colour.dead;
      context.fill();
      context.beginPath();
      context.moveTo(x - size, y - size);
      context.lineTo(x + size, y + size);
      context.moveTo(x + size, y - size);
      context.lineTo(x - size, y + size);
      context.lineWidth = 2;
      context.strokeStyle = colour.ink;
      context.stroke();
    } else if (status === "safe_stop") {
      context.fillStyle = colour.stop;
      context.fill();
      context.lineWidth = 3;
      context.strokeStyle = colour.outline;
      context.stroke();
    } else {
      context.fillStyle = colour.paper;
      context.fill();
      context.setLineDash([3, 2]);
      context.lineWidth = 2;
      context.strokeStyle = colour.grey;
      context.stroke();
      context.setLineDash([]);
    }
  }

  point(pointer) {
    this.pointer = pointer;
    this.tell();
  }

  // Label the robot under the pointer, even one that is too small for its number.
  tell() {
    const { pointer, label, canvas } = this;
    const far = (spot) => Math.hypot(spot.x - pointer.x, spot.y - pointer.y) - spot.size;
    const nearest = pointer && this.spots.reduce((best, spot) => (best && far(best) <= far(spot) ? best : spot), null);
    label.hidden = !nearest || far(nearest) > NEAR;
    if (label.hidden) {
      return;
    }
    label.textContent = nearest.text;
    const most = canvas.clientWidth - label.offsetWidth;
    const x = canvas.offsetLeft + Math.min(Math.max(nearest.x - label.offsetWidth / 2, 0), most);
    const y = canvas.offsetTop + nearest.y - nearest.size - label.offsetHeight - 6;
    label.style.transform = `translate(${x}px, ${y}px)`;
  }

  // Describe the canvas for screen readers, at most once a second.
  describe(hello, frame) {
    const now = performance.now();
    if (now - this.described < 1000) {
      return;
    }
    this.described = now;
    this.canvas.setAttribute("aria-label", `${this.told(hello, frame)}; ${hello.robots.length} robots, listed in the table of robots`);
  }

  told(hello, frame) {
    const degrees = ((frame.angle ?? 0) * 180) / Math.PI;
    return `The plane at ${short(frame.time, 4)} s: angle ${short(frame.angle, 4)} rad, which is ${short(degrees, 3)} degrees`;
  }
}
