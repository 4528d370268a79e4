// Curves over time, drawn by uPlot (third_party/uplot).
import { chartsOf, roles, titled } from "./description.js";
import { colours, eventColour, font, short, unitOf } from "./drawing.js";
import { kindColour, kindOf } from "./symbols.js";

// Sizes in px, with texts of the usual size:
const HEIGHT = 155;
const SPACE = 20; // between two labels on the left, at least
const SPACE_BELOW = 50; // between two labels below
const INTERVAL = 120; // ms between two redraws of growing curves
const NARROWEST = 62; // width of the left axis
const TICKS = 18; // of it for ticks and gaps
const FLAG = 16; // above a chart, for the marks of events
const LINE = 1.6; // width of a curve

const POSITIONS = "chart-positions";
const SIDES = ["ink", "quiet"]; // colours of the robots that start above 0, and of the others
const BANDS = [[6, 2, "22"], [5, 3, "44"]]; // of the positions of each side: series above, series below, opacity
const PERCENTILES = 7; // lines of each side
const DASHES = { lowest: [2, 3], highest: [2, 3], "5 %": [6, 4], "95 %": [6, 4], "25 %": [6, 4], "75 %": [6, 4] };
const MOST_NAMED = 12; // robots named in the legend of the positions

const DISTURBANCE = "disturbance"; // what an event that changes the disturbance says
const BAND = 2; // px, width of a shaded interval, at least

const disturbs = ({ kind, words }) => kind === "STEERING" && words === DISTURBANCE;

// Labels of an axis, with enough digits to tell them apart.
function labels(splits, increment) {
  const largest = Math.max(...splits.map(Math.abs));
  const plain = largest >= 1e-3 && largest < 1e6;
  const places = Math.min(Math.max(0, 1 - Math.floor(Math.log10(increment))), 100);
  return splits.map((split) => {
    const value = Number(split.toFixed(places));
    return plain || !value ? String(value || 0) : value.toExponential();
  });
}

const rule = document.createElement("canvas").getContext("2d");

function widest(texts, unit) {
  rule.font = font(unit);
  return Math.max(0, ...texts.map((text) => rule.measureText(text ?? "").width));
}

export class Charts {
  // `seek` receives the time of a click, s.
  constructor(seek) {
    this.seek = seek;
    this.drawn = 0;
    this.stale = false;
    this.zoom = null; // the range chosen by dragging, { min, max } in s, until a double click
    this.unit = 1; // size of texts
    this.events = [];
    this.robots = [];
    this.span = 0; // s before the time shown; 0: the whole run
    this.positions = { time: [], labels: [], bands: false, lines: [] };
    this.coordinate = 0; // of which the positions are shown
    document.getElementById("span").addEventListener("change", (event) => {
      this.span = Number(event.target.value);
      this.zoom = this.window = null;
      this.stale = true;
      this.drawn = 0;
    });
    document.getElementById("coordinate").addEventListener("change", (event) => {
      this.coordinate = Number(event.target.value);
      this.build();
    });
    this.plots = [];
    new ResizeObserver(() => this.resize()).observe(document.getElementById(POSITIONS).parentElement);
    window.addEventListener("appearancechange", () => this.build());
  }

  build() {
    if (!this.system) {
      return; // nothing is known yet
    }
    const colour = colours();
    const { zoom } = this;
    const unit = unitOf(document.getElementById(POSITIONS));
    [this.unit, this.left] = [unit, NARROWEST * unit];
    for (const plot of this.plots) {
      plot.destroy();
    }
    const sync = window.uPlot.sync("time");
    this.plots = [...this.charts, this.positionsChart(colour)].map(({ place, title, lines, data, named, bands }) => {
      const node = document.getElementById(place);
      const axis = { stroke: colour.quiet, grid: { stroke: colour.grid, width: 1 }, ticks: { stroke: colour.grid, width: 1 }, font: font(unit), values: (_, splits, axis, space, increment) => labels(splits, increment) };
      data ??= () => [this.curves.time, ...lines.map((one) => one.of(this.curves))];
      const plot = new window.uPlot(
        {
          title,
          width: Math.max(node.clientWidth, 200),
          height: HEIGHT,
          padding: [FLAG * unit, null, null, null],
          legend: { show: named !== false },
          scales: { x: { time: false, auto: () => this.zoom === null && !this.span } },
          axes: [{ ...axis, space: SPACE_BELOW * unit, size: 14 + 18 * unit }, { ...axis, space: SPACE * unit, size: (_, values) => this.room(values ?? []) }],
          series: [
            { label: "time, s", value: (_, time) => (time === null ? "--" : String(Number(time.toPrecision(9)))) },
            ...lines.map((one) => ({ label: one.label, value: (_, value) => (value === null ? "--" : short(value)), stroke: one.stroke ?? colour[one.colour], width: LINE * unit, pxAlign: 0, dash: one.dash, spanGaps: false, points: { show: false } })),
          ],
          bands: bands?.map(([high, low, fill, opacity]) => ({ series: [high, low], fill: colour[fill] + opacity })),
          cursor: { sync: { key: sync.key }, drag: { x: true, y: false } },
          hooks: { setScale: [(one, key) => key === "x" && this.zoomed(one)], drawClear: [(one) => this.shade(one, colour)], draw: [(one) => this.place(one), (one) => this.flags(one, colour)] },
        },
        data(),
        node,
      );
      const now = document.createElement("div");
      now.className = "now";
      plot.over.append(now);
      plot.now = now;
      plot.fetch = data;
      plot.given = [data()[0][0], data()[0].at(-1)];
      if (zoom) {
        plot.setScale("x", zoom);
      }
      plot.over.addEventListener("click", (event) => this.seek(plot.posToVal(event.offsetX, "x")));
      return plot;
    });
    queueMicrotask(() => this.resize()); // after uPlot has made titles and legends
  }

  // The chart of the positions: a line per robot, or for many robots percentile bands of each side on which they start.
  positionsChart(colour) {
    const { labels, bands } = this.positions;
    const own = new Map(this.robots.map((robot) => [`robot ${robot.id}`, kindColour(kindOf(this.system, robot))]));
    const side = (index) => colour[SIDES[Math.floor(index / PERCENTILES)]];
    const lines = labels.map((label, index) => ({ label, stroke: bands ? side(index) : own.get(label), dash: DASHES[label.split(": ")[1]] }));
    const what = titled(roles(this.system).robot[this.coordinate]);
    const title = bands ? `${what}: by side of the start, median, 50 and 90 %, extremes` : what;
    const areas = SIDES.flatMap((fill, one) => BANDS.map(([high, low, opacity]) => [high + one * PERCENTILES, low + one * PERCENTILES, fill, opacity]));
    const first = this.coordinate * labels.length; // each coordinate has as many lines
    const data = () => [this.positions.time, ...this.positions.lines.slice(first, first + labels.length)];
    return { place: POSITIONS, title, lines, named: labels.length <= MOST_NAMED, bands: bands ? areas : undefined, data };
  }

  hello({ robots, system }) {
    this.robots = robots;
    if (system.name === this.system?.name) {
      return;
    }
    this.system = system;
    this.charts = chartsOf(system);
    this.curves = { time: [], ...system.rows.filter(({ role }) => role !== "robot" && role !== "constant").map(() => []) };
    this.coordinate = 0;
    const choice = document.getElementById("coordinate");
    choice.replaceChildren(...roles(system).robot.map((one, index) => new Option(titled(one), index)));
    choice.parentElement.hidden = choice.length < 2;
    const last = document.getElementById(POSITIONS);
    const made = this.charts.map(({ place, says }) => {
      const node = Object.assign(document.createElement("div"), { id: place, className: "chart", role: "img" });
      node.setAttribute("aria-label", says);
      return node;
    });
    last.parentElement.replaceChildren(...made, last);
    this.build();
  }

  takeEvents(message) {
    this.events = message.replace ? message.events : [...this.events, ...message.events].slice(-1000);
    this.stale = true;
  }

  takePositions(message) {
    const same = message.bands === this.positions.bands && message.labels.join() === this.positions.labels.join();
    if (message.replace || !same) {
      const { time, labels, bands, lines } = message;
      this.positions = { time, labels, bands, lines };
    } else {
      this.positions.time = [...this.positions.time, ...message.time];
      this.positions.lines = this.positions.lines.map((line, index) => [...line, ...message.lines[index]]);
    }
    if (!same) {
      this.build();
    }
    this.stale = true;
  }

  // The intervals shown in which the parent is disturbed; the first of adjacent ones is marked.
  disturbances({ min, max }) {
    const changes = this.events.filter(disturbs).sort((one, other) => one.time - other.time);
    const bands = changes.map(({ time, value }, index) => ({ time, end: changes[index + 1]?.time ?? max, value, first: !changes[index - 1]?.value }));
    return bands.filter(({ time, end, value }) => value && end >= min && time <= max);
  }

  // Shade the intervals in which the parent is disturbed, below the curves.
  shade({ ctx, bbox, valToPos, scales }, colour) {
    ctx.save();
    ctx.fillStyle = `${colour.error}33`;
    for (const { time, end } of this.disturbances(scales.x)) {
      const [x0, x1] = [Math.max(time, scales.x.min), Math.min(end, scales.x.max)].map((one) => valToPos(one, "x", true));
      ctx.fillRect(x0, bbox.top, Math.max(x1 - x0, BAND), bbox.height);
    }
    ctx.restore();
  }

  // Marks of events above a chart, at most one per pixel, each with a faint line down.
  flags({ ctx, bbox, valToPos, scales, root }, colour) {
    const ratio = window.devicePixelRatio || 1;
    const bands = this.disturbances(scales.x);
    const begins = bands.filter(({ first, time }) => first && time >= scales.x.min).map((band) => ({ ...band, words: DISTURBANCE, band: true }));
    const shown = [...begins, ...this.events.filter((one) => !disturbs(one) && one.time >= scales.x.min && one.time <= scales.x.max)];
    const marks = shown.sort((one, other) => one.time - other.time).map((event) => ({ ...event, x: Math.round(valToPos(event.time, "x", true)) }));
    const apart = marks.filter(({ x, band }, index) => band || marks[index - 1]?.band || x !== marks[index - 1]?.x);
    const named = root.parentElement.id === this.charts[0].place;
    ctx.save();
    ctx.font = font(this.unit * ratio);
    ctx.textAlign = "left";
    ctx.setLineDash([]);
    const [y, size] = [bbox.top, 5 * ratio * this.unit];
    apart.forEach(({ x, kind, words, agent, band }, index) => {
      const text = `${agent ? `${agent} ` : ""}${words}`;
      const end = x + 2 * size + ctx.measureText(text).width;
      if (named && end < Math.min(bbox.left + bbox.width, (apart[index + 1]?.x ?? Infinity) - size)) {
        ctx.fillStyle = colour.quiet;
        ctx.fillText(text, x + (band ? 0 : 1.4 * size), y - 3 * ratio);
      }
      if (band) {
        return;
      }
      ctx.beginPath();
      ctx.moveTo(x, y);
      ctx.lineTo(x - size, y - 1.6 * size);
      ctx.lineTo(x + size, y - 1.6 * size);
      ctx.closePath();
      ctx.fillStyle = eventColour(kind, colour);
      ctx.fill();
      ctx.strokeStyle = colour.outline;
      ctx.lineWidth = ratio;
      ctx.stroke();
      ctx.globalAlpha = 0.4;
      ctx.strokeStyle = colour.ink;
      ctx.beginPath();
      ctx.moveTo(x, y);
      ctx.lineTo(x, y + bbox.height);
      ctx.stroke();
      ctx.globalAlpha = 1;
    });
    ctx.restore();
  }

  ends() {
    const { time } = this.curves;
    return [time[0], time[time.length - 1]];
  }

  // Note whether a part of the plot's data is shown; newer data may not be in the plot yet.
  zoomed(plot) {
    const { min, max } = plot.scales.x;
    const { span, window: wanted } = this;
    if (span && (min === null || (wanted && Math.abs(min - wanted.min) + Math.abs(max - wanted.max) < 1e-6))) {
      return;
    }
    if (span && wanted) {
      this.span = 0; // the user chose another range
      document.getElementById("span").value = "0";
    }
    const [first, last] = plot.given ?? [];
    if (first === undefined) {
      return; // no data yet: the scale is meaningless
    }
    this.zoom = min > first || max < last ? { min, max } : null;
  }

  // The width of the left axis, px: that of the widest labels for all charts, which aligns their time axes.
  room(texts) {
    const wanted = Math.ceil(widest(texts, this.unit) + TICKS * this.unit);
    if (wanted > this.left) {
      this.left = wanted;
      queueMicrotask(() => this.plots.forEach((plot) => plot.redraw(true, true)));
    }
    return this.left;
  }

  resize() {
    if (this.system && unitOf(document.getElementById(POSITIONS)) !== this.unit) {
      this.build();
      return;
    }
    const filled = document.documentElement.dataset.layout === "presenter"; // the chart fills its panel
    for (const plot of this.plots) {
      const { clientWidth: width, clientHeight } = plot.root.parentElement;
      const height = filled ? Math.max(clientHeight - (plot.root.offsetHeight - plot.height), HEIGHT / 2) : HEIGHT;
      if (width > 0 && (width !== plot.width || height !== plot.height)) {
        plot.setSize({ width, height });
      }
    }
    this.mark(this.time ?? null);
  }

  take(message) {
    const points = { time: message.time, ...message.values };
    for (const name of Object.keys(this.curves)) {
      if (message.replace) {
        this.curves[name] = points[name];
      } else {
        for (const value of points[name]) {
          this.curves[name].push(value);
        }
      }
    }
    this.stale = true;
    if (message.replace) {
      this.drawn = 0;
      if (this.zoom && !(this.zoom.min < this.ends()[1])) {
        this.zoom = null; // of another run
      }
    }
  }

  // Draw new data at a limited rate, and mark the time shown.
  draw(now, time) {
    if (this.stale && now - this.drawn > INTERVAL) {
      this.drawn = now;
      this.stale = false;
      this.plots.forEach((plot) => {
        const data = plot.fetch();
        plot.given = [data[0][0], data[0].at(-1)];
        plot.setData(data);
      });
    }
    this.follow(time);
    this.mark(time);
  }

  // Show the last seconds up to a time, if the user chose so.
  follow(time) {
    const first = this.ends()[0];
    if (!this.span || time === null || first === undefined) {
      return;
    }
    const max = Math.max(time, first + this.span);
    this.window = { min: max - this.span, max };
    for (const plot of this.plots) {
      plot.setScale("x", this.window);
    }
  }

  mark(time) {
    this.time = time;
    for (const plot of this.plots) {
      this.place(plot);
    }
  }

  place({ now, over, valToPos }) {
    if (!now) {
      return; // the plot is still being built
    }
    const place = this.time === null ? -1 : valToPos(this.time, "x");
    const inside = place >= 0 && place <= over.clientWidth;
    now.hidden = !inside;
    if (inside) {
      now.style.transform = `translateX(${place}px)`;
    }
  }
}
