// The symbols of the kinds of robots, which the description of the system names.

const SHAPES = {
  circle: (path, x, y, size) => path.arc(x, y, size, 0, 2 * Math.PI),
  square: (path, x, y, size) => {
    const side = size * Math.sqrt(Math.PI); // of the same area
    path.rect(x - side / 2, y - side / 2, side, side);
  },
  diamond: (path, x, y, size) => {
    const far = 1.25 * size; // of the same area
    [[-far, 0], [0, -far], [far, 0], [0, far], [-far, 0]].forEach(([dx, dy]) => path.lineTo(x + dx, y + dy));
  },
};
const SIGNS = {
  circle: ["circle", { cx: 8, cy: 8, r: 6 }],
  square: ["rect", { x: 2.5, y: 2.5, width: 11, height: 11 }],
  diamond: ["path", { d: "M8 0.5 15.5 8 8 15.5 0.5 8Z" }],
};
const SVG = "http://www.w3.org/2000/svg";
const LIGHTER = 0.25; // white in the colour of a kind on dark ground

// The kind of a robot.
export const kindOf = ({ kinds }, robot) => kinds.find(({ name }) => name === robot.kind);

// The colour of a kind on the ground of the theme.
export function kindColour({ colour }) {
  const white = document.documentElement.dataset.theme === "dark" ? LIGHTER : 0;
  const parts = [1, 3, 5].map((begin) => Number.parseInt(colour.slice(begin, begin + 2), 16));
  return `rgb(${parts.map((part) => Math.round(part + white * (255 - part))).join(", ")})`;
}

// Add the outline of a robot of a kind to the path of a context.
export function outline(context, { shape }, x, y, size) {
  SHAPES[shape](context, x, y, size);
}

// Return an entry of the legend for each kind that a robot has.
export function legend({ robots, system }) {
  const kinds = system.kinds.filter(({ name }) => robots.some(({ kind }) => kind === name));
  return kinds.map((kind) => {
    const item = Object.assign(document.createElement("li"), { className: "kind" });
    const sign = drawn("svg", { viewBox: "0 0 16 16", "aria-hidden": true });
    sign.append(drawn(...SIGNS[kind.shape]));
    sign.style.fill = kindColour(kind);
    item.append(sign, kind.legend);
    return item;
  });
}

function drawn(tag, attributes) {
  const element = document.createElementNS(SVG, tag);
  Object.entries(attributes).forEach(([name, value]) => element.setAttribute(name, value));
  return element;
}
