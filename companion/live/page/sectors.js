// The nearest obstacle in each sector, the aircraft's nose up.
import { make } from "./chart.js";

const RADIUS = 92, COUNT = 72, RINGS = 4;

export class SectorView {
  constructor(svg) {
    this.svg = svg;
    this.wedges = make("g", {}, svg);
    for (let ring = 1; ring <= RINGS; ring += 1) make("circle", { r: (RADIUS * ring) / RINGS, class: "axis" }, svg);
    this.labels = [2, 4].map((ring) => make("text", { x: 4, y: -(RADIUS * ring) / RINGS - 3 }, svg));
    make("path", { d: "M0,-9L6,8L0,4L-6,8Z", fill: "var(--ink)" }, svg);
  }

  draw({ distance_m, known, clear, max_m }) {
    const wedges = document.createDocumentFragment();
    let nearest_m = Infinity;
    for (let i = 0; i < COUNT; i += 1) {
      if (!known[i] && !clear[i]) continue;
      const share = clear[i] ? 1 : Math.min(1, distance_m[i] / max_m);
      if (known[i] && !clear[i]) nearest_m = Math.min(nearest_m, distance_m[i]);
      const [a, b] = [i - 0.5, i + 0.5].map((edge) => (edge * 2 * Math.PI) / COUNT);
      const near = [a, b].map((angle) => point(angle, RADIUS * share)), far = [b, a].map((angle) => point(angle, RADIUS));
      if (clear[i]) make("path", { d: `M0,0L${near.join("L")}Z`, fill: "var(--green)", "fill-opacity": 0.18 }, wedges);
      else {
        make("path", { d: `M0,0L${near.join("L")}Z`, fill: "var(--sky)", "fill-opacity": 0.25 }, wedges);
        make("path", { d: `M${near.join("L")}L${far.join("L")}Z`, fill: "var(--vermillion)", "fill-opacity": 0.75 }, wedges);
      }
    }
    document.getElementById("obstacles").hidden = false;
    this.wedges.replaceChildren(wedges);
    this.labels.forEach((label, i) => { label.textContent = `${((max_m * (i + 1)) / 2).toFixed(0)} m`; });
    document.getElementById("sectors-word").textContent = Number.isFinite(nearest_m) ? `nearest ${nearest_m.toFixed(1)} m` : "all clear";
  }
}

const point = (angle, radius) => `${(radius * Math.sin(angle)).toFixed(1)},${(-radius * Math.cos(angle)).toFixed(1)}`;
