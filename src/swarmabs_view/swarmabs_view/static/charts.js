// Curves over time, drawn by uPlot (third_party/uplot).
import { colours, short } from "./drawing.js";

const HEIGHT = 150;
const INTERVAL = 120; // ms between two drawings of growing curves
const FONT = "11px system-ui, sans-serif";
const NARROWEST = 62; // px of the axis on the left
const BESIDE = 18; // px of it that are no label: ticks and gaps

const minus = (wanted, actual) => wanted.map((one, index) => (one === null || actual[index] === null ? null : one - actual[index]));

const CHARTS = [
  {
    place: "chart-angle",
    title: "angle and reference, rad",
    lines: [
      { label: "angle", colour: "actual", of: (c) => c.angle },
      { label: "reference", colour: "manifold", dash: [8, 5], of: (c) => c.reference },
    ],
  },
  { place: "chart-error", title: "error of the angle, rad", lines: [{ label: "reference − angle", colour: "actual", of: (c) => minus(c.reference, c.angle) }] },
  { place: "chart-torque", title: "error of the torque, N m", lines: [{ label: "wanted − torque", colour: "di", of: (c) => minus(c.desired_torque, c.torque) }] },
  { place: "chart-inertia", title: "error of the inertia, kg m²", lines: [{ label: "wanted − inertia", colour: "good", of: (c) => minus(c.desired_inertia, c.inertia) }] },
];

// Labels of an axis, with as many digits as tell them apart.
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

function widest(texts) {
  rule.font = FONT;
  return Math.max(0, ...texts.map((text) => rule.measureText(text ?? "").width));
}

export class Charts {
  // `seek` is told at which time a click was.
  constructor(seek) {
    this.seek = seek;
    this.curves = { time: [], angle: [], reference: [], torque: [], desired_torque: [], inertia: [], desired_inertia: [] };
    this.steepest = 0; // the largest angle, rad
    this.drawn = 0;
    this.stale = false;
    this.zoom = null; // what was dragged over, { min, max } in s, until a double click
    this.left = NARROWEST;
    this.build();
    new ResizeObserver(() => this.resize()).observe(document.getElementById(CHARTS[0].place));
    window.addEventListener("themechange", () => this.build());
  }

  build() {
    const colour = colours();
    const { zoom } = this;
    for (const plot of this.plots ?? []) {
      plot.destroy();
    }
    const sync = window.uPlot.sync("time");
    this.plots = CHARTS.map(({ place, title, lines }) => {
      const node = document.getElementById(place);
      const axis = { stroke: colour.quiet, grid: { stroke: colour.grid, width: 1 }, ticks: { stroke: colour.grid, width: 1 }, font: FONT, values: (_, splits, axis, space, increment) => labels(splits, increment) };
      const plot = new window.uPlot(
        {
          title,
          width: Math.max(node.clientWidth, 200),
          height: HEIGHT,
          scales: { x: { time: false, auto: () => this.zoom === null } },
          axes: [{ ...axis, size: 32 }, { ...axis, size: (_, values) => this.room(values ?? []) }],
          series: [
            { label: "time, s", value: (_, time) => (time === null ? "--" : String(Number(time.toPrecision(9)))) },
            ...lines.map((one) => ({ label: one.label, value: (_, value) => (value === null ? "--" : short(value)), stroke: colour[one.colour], width: 1.6, dash: one.dash, spanGaps: false, points: { show: false } })),
          ],
          cursor: { sync: { key: sync.key }, drag: { x: true, y: false } },
          hooks: { setScale: [(one, key) => key === "x" && this.zoomed(one)], draw: [(one) => this.place(one)] },
        },
        this.data(lines),
        node,
      );
      const now = document.createElement("div");
      now.className = "now";
      plot.over.append(now);
      plot.now = now;
      plot.given = this.ends();
      if (zoom) {
        plot.setScale("x", zoom);
      }
      plot.over.addEventListener("click", (event) => this.seek(plot.posToVal(event.offsetX, "x")));
      return plot;
    });
    this.mark(this.time ?? null);
  }

  data(lines) {
    return [this.curves.time, ...lines.map((one) => one.of(this.curves))];
  }

  ends() {
    const { time } = this.curves;
    return [time[0], time[time.length - 1]];
  }

  // Note whether a part is shown, of the data that the plot was given: more may have come since.
  zoomed(plot) {
    const { min, max } = plot.scales.x;
    const [first, last] = plot.given ?? [];
    this.zoom = min > first || max < last ? { min, max } : null;
  }

  // The room for labels on the left, px: of all charts that of the widest, so that their times stand below each other.
  room(texts) {
    const wanted = Math.ceil(widest(texts)) + BESIDE;
    if (wanted > this.left) {
      this.left = wanted;
      queueMicrotask(() => this.plots.forEach((plot) => plot.redraw(true, true)));
    }
    return this.left;
  }

  resize() {
    for (const plot of this.plots) {
      const width = plot.root.parentElement.clientWidth;
      if (width > 0 && width !== plot.width) {
        plot.setSize({ width, height: HEIGHT });
      }
    }
    this.mark(this.time ?? null);
  }

  take(message) {
    for (const name of Object.keys(this.curves)) {
      if (message.replace) {
        this.curves[name] = message[name];
      } else {
        for (const value of message[name]) {
          this.curves[name].push(value);
        }
      }
    }
    const largest = [...message.angle, ...message.reference].reduce((most, one) => Math.max(most, Math.abs(one ?? 0)), 0);
    this.steepest = message.replace ? largest : Math.max(this.steepest, largest);
    this.stale = true;
    if (message.replace) {
      this.drawn = 0;
      if (this.zoom && !(this.zoom.min < this.ends()[1])) {
        this.zoom = null; // of something else
      }
    }
  }

  // Draw what has come, not too often, and mark the time that is shown.
  draw(now, time) {
    if (this.stale && now - this.drawn > INTERVAL) {
      this.drawn = now;
      this.stale = false;
      this.plots.forEach((plot, index) => {
        plot.given = this.ends();
        plot.setData(this.data(CHARTS[index].lines));
      });
    }
    this.mark(time);
  }

  mark(time) {
    this.time = time;
    for (const plot of this.plots) {
      this.place(plot);
    }
  }

  place({ now, over, valToPos }) {
    if (!now) {
      return; // the plot is just being made
    }
    const place = this.time === null ? -1 : valToPos(this.time, "x");
    const inside = place >= 0 && place <= over.clientWidth;
    now.hidden = !inside;
    if (inside) {
      now.style.transform = `translateX(${place}px)`;
    }
  }
}
