// Health and events: clocks, rates, shots, refusals, sentences.
const MOST_EVENTS = 60;
const cell = (content, kind = "") => {
  const element = document.createElement("td");
  element.className = kind;
  element.textContent = content;
  return element;
};

function fill(id, heads, rows) {
  const head = document.createElement("tr");
  for (const [name, kind] of heads) {
    const element = document.createElement("th");
    element.className = kind;
    element.textContent = name;
    head.append(element);
  }
  const lines = rows.map((cells) => {
    const line = document.createElement("tr");
    line.append(...cells);
    return line;
  });
  document.getElementById(id).replaceChildren(head, ...lines);
}

export class Health {
  #clocks = new Map();
  #before = null;
  #rates = {};

  constructor(about) {
    this.about = about;
    this.#streams();
  }

  clock(state) {
    this.#clocks.set(state.clock, state);
    const rows = [...this.#clocks.values()].map(({ clock, synced, bound_ns, skew_ppm }) => [
      cell(clock.replace("_", " ")), cell(synced ? "synced" : "not synced", synced ? "" : "bad"),
      cell(synced ? `${(bound_ns / 1e6).toFixed(2)} ms` : "\u2013", "n"), cell(synced ? `${skew_ppm.toFixed(1)} ppm` : "\u2013", "n"),
    ]);
    fill("clocks", [["clock", ""], ["", ""], ["bound", "n"], ["skew", "n"]], rows);
  }

  status({ at_host_ns, counters }) {
    const names = Object.keys(this.about.sensors);
    const passed_s = this.#before && (at_host_ns - this.#before.at_host_ns) / 1e9;
    if (passed_s > 0.5) {
      for (const name of names) {
        this.#rates[name] = ((counters[`samples ${name}`] ?? 0) - (this.#before.counters[`samples ${name}`] ?? 0)) / passed_s;
      }
      this.#before = null;
    }
    this.#before ??= { at_host_ns, counters };
    this.#streams();
    const refused = Object.entries(counters).filter(([name]) => this.about.reasons.includes(name));
    const listed = refused.sort(([, a], [, b]) => b - a).slice(0, 6).map(([name, count]) => `${count} ${name}`).join(", ");
    document.getElementById("refusals").textContent = listed ? `Refused so far: ${listed}.` : "Nothing refused.";
  }

  #streams() {
    const rows = Object.entries(this.about.sensors).map(([name, { rate_hz, axes }]) => {
      const now_hz = this.#rates[name];
      const isBad = now_hz !== undefined && Math.abs(now_hz / rate_hz - 1) > 0.15;
      return [cell(name), cell(axes), cell(now_hz === undefined ? "\u2013" : `${now_hz.toFixed(0)} Hz`, isBad ? "n bad" : "n"), cell(`${rate_hz.toFixed(0)} Hz`, "n")];
    });
    fill("streams", [["sensor", ""], ["axes", ""], ["rate", "n"], ["believed", "n"]], rows);
  }
}

export class Events {
  #list = document.getElementById("events");
  #count = 0;

  add(severity, text, at_s) {
    if (!this.#count) this.#list.replaceChildren();
    this.#count += 1;
    const line = document.createElement("li"), time = document.createElement("time"), words = document.createElement("span");
    line.className = severity <= 3 ? "error" : severity === 4 ? "warning" : "";
    time.textContent = `${at_s.toFixed(1)} s`;
    words.textContent = text;
    line.append(time, words);
    this.#list.prepend(line);
    while (this.#list.children.length > MOST_EVENTS) this.#list.lastChild.remove();
  }
}
