// The wing seen from behind, bending as the tracker says, with both cameras and where they look.
import { make } from "./chart.js";

const WIDTH = 640, ROOT_X = 320, ROOT_Y = 112, SPAN_X = 262;
const RAISED_PX_PER_M = 2600; // 10 mm at the tip is 26 px
const LOOK_PX = 104, DOWN = 25, STATIONS = 24;
const TURNED = 6; // times that the cameras' turn is exaggerated
const HALF_LABEL = 68; // of "+25.9 mm" in a phone's large letters

// Deflection of a cantilever's tip load, 1 at the tip.
const shape = (eta) => (3 * eta ** 2 - eta ** 3) / 2;

export class WingView {
  constructor(svg, about) {
    this.about = about;
    this.looksDown = about.orientation === DOWN;
    const raised = (RAISED_PX_PER_M * about.semispan_m) / SPAN_X;
    document.getElementById("exaggeration").textContent =
      `seen from behind, bending \u00d7${raised.toFixed(0)}, toe \u00d7${TURNED}`;
    make("line", { class: "axis", x1: ROOT_X - SPAN_X, x2: ROOT_X + SPAN_X, y1: ROOT_Y, y2: ROOT_Y, "stroke-dasharray": "4 5" }, svg);
    this.looks = [0, 1].map(() => make("path", { fill: "var(--sky)", "fill-opacity": 0.28, stroke: "var(--sky)", "stroke-opacity": 0.7 }, svg));
    this.wing = make("path", { fill: "none", stroke: "var(--blue)", "stroke-width": 7, "stroke-linecap": "round", "stroke-linejoin": "round" }, svg);
    make("circle", { cx: ROOT_X, cy: ROOT_Y, r: 21, fill: "var(--card)", stroke: "var(--blue)", "stroke-width": 6 }, svg);
    make("circle", { cx: ROOT_X, cy: ROOT_Y, r: 5, fill: "var(--blue)" }, svg);
    this.cameras = [0, 1].map(() => make("rect", { x: -9, y: -8, width: 18, height: 16, rx: 4, fill: "var(--orange)" }, svg));
    this.labels = [0, 1].map(() => make("text", { "text-anchor": "middle", class: "strong" }, svg));
    for (const [side, word] of [[0, "left"], [1, "right"]]) {
      make("text", { x: ROOT_X + (side ? 1 : -1) * SPAN_X, y: 264, "text-anchor": "middle" }, svg).textContent = word;
    }
  }

  // tips in metres, [left, right]
  draw(tips) {
    const points = [];
    for (let i = -STATIONS; i <= STATIONS; i += 1) {
      const eta = Math.abs(i) / STATIONS;
      points.push(`${(ROOT_X + (i / STATIONS) * SPAN_X).toFixed(1)},${this.#height(tips[i < 0 ? 0 : 1], eta).toFixed(1)}`);
    }
    this.wing.setAttribute("d", `M${points.join("L")}`);
    tips.forEach((tip_m, side) => this.#camera(tip_m, side));
  }

  #height(tip_m, eta) {
    return ROOT_Y - Math.max(-76, Math.min(76, tip_m * RAISED_PX_PER_M)) * shape(eta);
  }

  #camera(tip_m, side) {
    const way = side ? 1 : -1, x = ROOT_X + way * SPAN_X, y = this.#height(tip_m, 1) + 10;
    const slope = this.about.modes[0].slope_factor_radpm * tip_m * TURNED;
    // tips up turn the axes of a pair that looks down outwards
    const turn = way * Math.max(-0.6, Math.min(0.6, slope));
    this.cameras[side].setAttribute("transform", `translate(${x} ${y}) rotate(${(-turn * 180) / Math.PI})`);
    this.labels[side].setAttribute("x", Math.max(HALF_LABEL, Math.min(WIDTH - HALF_LABEL, x)));
    this.labels[side].setAttribute("y", Math.max(14, y - 26));
    this.labels[side].textContent = `${tip_m < 0 ? "\u2212" : "+"}${Math.abs(1e3 * tip_m).toFixed(1)} mm`;
    if (!this.looksDown || !this.about.cameras[side]) return;
    const ray = (spread) => `${(x + LOOK_PX * Math.sin(turn + spread)).toFixed(1)},${(y + LOOK_PX * Math.cos(turn + spread)).toFixed(1)}`;
    this.looks[side].setAttribute("d", `M${x},${y}L${ray(-0.2)}L${ray(0.2)}Z`);
  }
}
