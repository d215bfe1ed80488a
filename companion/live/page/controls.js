// Parameters and recordings: what can be changed from here, and what can be fetched.
import { address } from "./protocol.js";

const LIST_MS = 3000, REFRESH_MS = 1500;
const UNSETTABLE = {
  replay: "as this replay uses them; they cannot be set here", demo: "the demo's parameters cannot be set",
  live: "nothing can be set here",
};
const element = (name, attributes = {}, ...children) => {
  const made = Object.assign(document.createElement(name), attributes);
  made.append(...children);
  return made;
};

let hidden = 0;
export function toast(words) {
  const place = document.getElementById("toast");
  place.textContent = words;
  place.classList.add("shown");
  clearTimeout(hidden);
  hidden = setTimeout(() => place.classList.remove("shown"), 4000);
}

async function post(path, content) {
  const answer = await fetch(address(path), {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(content),
  });
  if (!answer.ok) throw new Error((await answer.text()).trim());
}

export class Parameters {
  #rows = new Map();

  constructor(about) {
    const place = document.getElementById("parameters");
    document.getElementById("parameters-word").textContent = about.can_set
      ? "in force at once, kept over a restart; MAVLink's are the same"
      : UNSETTABLE[about.kind];
    for (const row of about.parameters) place.append(this.#row(row, about.can_set));
    document.getElementById("find").oninput = ({ target }) => {
      const word = target.value.toLowerCase();
      for (const { line, row } of this.#rows.values()) line.hidden = !`${row.name} ${row.text}`.toLowerCase().includes(word);
    };
  }

  set(name, value) {
    const entry = this.#rows.get(name);
    if (!entry) return;
    entry.row.value = value;
    if (document.activeElement !== entry.field) entry.field.value = String(value);
    entry.line.classList.toggle("changed", value !== entry.row.default);
  }

  // What is in force now: changes made while this page was not connected are not told again. Gives all the facts.
  async refresh() {
    const answer = await fetch(address("about.json")).catch(() => null);
    if (!answer?.ok) return null;
    const about = await answer.json();
    for (const { name, value } of about.parameters) this.set(name, value);
    return about;
  }

  #row(row, canSet) {
    const field = row.choices.length
      ? element("select", {}, ...row.choices.map((word, i) => element("option", { value: String(row.minimum + i) }, word)))
      : element("input", { type: "number", min: row.minimum, max: row.maximum, step: row.integer ? 1 : "any" });
    field.value = String(row.value);
    field.disabled = !canSet;
    field.setAttribute("aria-label", row.name);
    field.onchange = async () => {
      if (field.value === "") {  // emptied, or no number
        field.value = String(row.value);
        return;
      }
      try {
        await post("parameters", { name: row.name, value: Number(field.value) });
        setTimeout(() => this.refresh(), REFRESH_MS);
        toast(row.live ? `${row.name} asked for: ${field.value}` : `${row.name} ${field.value}: from the next start on`);
      } catch (error) {
        toast(error.message);
        field.value = String(row.value);
      }
    };
    const notes = row.live ? "" : " (restart)";
    const line = element("div", { className: "row" },
      element("div", {}, element("b", {}, row.name, element("small", {}, notes)), element("p", {}, row.text)),
      element("div", { className: "field" }, field, element("span", { className: "unit" }, row.unit)));
    line.classList.toggle("changed", row.value !== row.default);
    this.#rows.set(row.name, { line, field, row });
    return line;
  }
}

export class Recordings {
  #button = document.getElementById("record");
  #isOn = false;

  constructor({ kind, title }) {
    this.always = kind === "replay" ? `${title} is shown on this page; recordings of its folder:` : "recorded since the start";
    this.#button.onclick = async () => {
      try {
        await post("record", { on: !this.#isOn });
      } catch (error) {
        toast(error.message);
      }
      setTimeout(() => this.refresh(), 400);
    };
    this.refresh();
    setInterval(() => this.refresh(), LIST_MS);
  }

  async refresh() {
    if (document.visibilityState !== "visible") return;
    const answer = await fetch(address("recordings.json")).catch(() => null);
    if (!answer?.ok) return;
    const { always, on, failure, files } = await answer.json();
    this.#isOn = on;
    this.#button.hidden = always;
    this.#button.classList.toggle("on", on);
    this.#button.textContent = on ? "Stop recording" : "Record";
    const words = failure || (always ? this.always : on ? "recording" : "");
    document.getElementById("recording").textContent = words;
    const lines = files.map(({ name, bytes }) => element("li", {},
      element("a", { href: address(`recordings/${encodeURIComponent(name)}`), download: name }, name),
      element("span", {}, `${(bytes / 1e6).toFixed(1)} MB`)));
    document.getElementById("files").replaceChildren(...lines);
  }
}
