// Small time charts in SVG: lines with bands, dots, a tidy axis.
import { window_s } from "./state.js";

const MARGIN = { left: 40, right: 8, top: 8, bottom: 18 };
const GAP_S = 2.5, SHORTEST_S = 12;

const make = (name, attributes, parent) => {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  parent?.append(element);
  return element;
};
export { make };

// Steps of 1, 2 or 5 that give about four lines.
function ticks(low, high) {
  const rough = (high - low) / 4 || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= rough);
  const list = [];
  for (let value = Math.ceil(low / step) * step; value <= high + 1e-9; value += step) list.push(value);
  return { list, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

export class Chart {
  // `unit` stands behind every number of the upright axis.
  constructor(svg, lines, { limits, dots = [], unit = "" }) {
    Object.assign(this, { svg, lines, limits, dots, unit });
    this.grid = make("g", {}, svg);
    this.layers = lines.map(({ color }) => ({
      band: make("path", { fill: color, "fill-opacity": 0.18, stroke: "none" }, svg),
      line: make("path", { fill: "none", stroke: color, "stroke-width": 2, "stroke-linejoin": "round" }, svg),
      lone: make("path", { class: "lone", fill: "none", stroke: color, "stroke-width": 6, "stroke-linecap": "round" }, svg),
    }));
    this.marks = dots.map(({ color, hollow }) =>
      make("path", { fill: "none", stroke: color, "stroke-width": hollow ? 1.5 : 4, "stroke-linecap": "round" }, svg));
  }

  // `edge` names the right end of the time axis.
  draw(points, now_s, edge = "now") {
    const { width, height } = this.svg.getBoundingClientRect();
    if (!width) return;
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const [low, high] = this.limits(points);
    const span_s = points.length ? Math.min(window_s, Math.max(SHORTEST_S, 3 * Math.ceil((now_s - points[0].t_s) / 3))) : window_s;
    const x = (t_s) => MARGIN.left + (1 + (t_s - now_s) / span_s) * (width - MARGIN.left - MARGIN.right);
    const y = (value) => {
      const share = Math.min(1, Math.max(0, (value - low) / (high - low)));
      return height - MARGIN.bottom - share * (height - MARGIN.top - MARGIN.bottom);
    };
    const shown = points.filter(({ t_s }) => t_s > now_s - span_s);
    this.#axes(low, high, x, y, now_s, width, height, span_s, edge);
    this.lines.forEach((line, i) => this.#line(this.layers[i], line, shown, x, y));
    this.dots.forEach((dot, i) => this.marks[i].setAttribute("d", shown.map((point) => dots(dot, point, x, y)).join("")));
  }

  #axes(low, high, x, y, now_s, width, height, span_s, edge) {
    const { list, digits } = ticks(low, high);
    const key = `${list}|${low}|${high}|${width}|${height}|${span_s}|${edge}`;
    if (key === this.key) return;
    this.key = key;
    this.grid.replaceChildren();
    for (const value of list) {
      make("line", { class: "axis", x1: MARGIN.left, x2: width - MARGIN.right, y1: y(value), y2: y(value) }, this.grid);
      const label = make("text", { x: MARGIN.left - 6, y: y(value) + 4, "text-anchor": "end" }, this.grid);
      label.textContent = `${value.toFixed(digits)}${this.unit}`;
    }
    for (const part of [3, 2, 1, 0]) {
      const ago_s = (part * span_s) / 3;
      const anchor = part === 0 ? "end" : part === 3 ? "start" : "middle";
      const label = make("text", { x: x(now_s - ago_s), y: height - 4, "text-anchor": anchor }, this.grid);
      label.textContent = ago_s ? `\u2212${ago_s} s` : edge;
    }
  }

  #line(layer, { value, sigma }, points, x, y) {
    let path = "", up = [], down = [], bands = "", lone = "", at = "", last = null;
    const close = () => {
      if (up.length > 1) bands += `M${up.join("L")}L${down.reverse().join("L")}Z`;
      else if (up.length) lone += `M${at}h0`; // a line of a single point is none
      up = []; down = [];
    };
    for (const point of points) {
      const now = value(point);
      if (now === null) continue;
      const begins = last === null || point.t_s - last > GAP_S;
      if (begins) close();
      at = `${x(point.t_s).toFixed(1)},${y(now).toFixed(1)}`;
      path += `${begins ? "M" : "L"}${at}`;
      const spread = sigma(point);
      up.push(`${x(point.t_s).toFixed(1)},${y(now + spread).toFixed(1)}`);
      down.push(`${x(point.t_s).toFixed(1)},${y(now - spread).toFixed(1)}`);
      last = point.t_s;
    }
    close();
    layer.line.setAttribute("d", path);
    layer.lone.setAttribute("d", lone);
    layer.band.setAttribute("d", bands);
  }
}

function dots({ value, hollow }, point, x, y) {
  const now = value(point);
  if (now === null) return "";
  const at = `${x(point.t_s).toFixed(1)},${y(now).toFixed(1)}`;
  return hollow ? `M${at}m-3,0a3,3 0 1,0 6,0a3,3 0 1,0 -6,0` : `M${at}h0`;
}
