// Markers that client programs plotted: points, lines and texts, each shown for a time.

import { Group } from "./three.module.min.js";
import { byId } from "./controls.js";
import { Discs, Lines } from "./lines.js";
import { hue } from "./shapes.js";

const MOST_TEXTS = 500; // maximum number of texts that are shown at a time, the latest ones

export class Markers extends Group {
  constructor(episode) {
    super();
    this.episode = episode;
    const { payload, about } = episode;
    const kind = (name, make) => {
      if (!(`marker_${name}` in about.arrays)) return [];
      const [places, style, times] = ["", "_style", "_time"].map((part) =>
        payload.array(`marker_${name}${part}`),
      );
      return groupsBySize(style).map(([size, members]) => {
        const mesh = make(size, members.length);
        this.add(mesh);
        return { mesh, members, places, style, times };
      });
    };
    this.lines = kind("line", (size, count) => new Lines(count, size));
    this.points = kind("point", (size, count) => new Discs(new Float32Array(3 * count), 0, 0, size));
    this.texts = (about.marker_texts ?? []).map((one) => ({
      ...one,
      time: [one.time[0], one.time[1] ?? Infinity],
    }));
    this.exists = this.lines.length + this.points.length + this.texts.length > 0;
    this.shown = []; // texts with their elements
    byId("texts").replaceChildren();
    // Times between which the same markers are shown
    [this.from, this.until] = [Infinity, -Infinity];
  }

  update() {
    const { time } = this.episode;
    if (time >= this.from && time < this.until) return;
    [this.from, this.until] = [-Infinity, Infinity];
    for (const { mesh, members, places, style, times } of this.lines) {
      let count = 0;
      for (const k of members) {
        if (!this.isShown(times[2 * k], times[2 * k + 1])) continue;
        mesh.put(count, places, 6 * k, places, 6 * k + 3, colour(style, k));
        count += 1;
      }
      mesh.show(count);
    }
    for (const { mesh, members, places, style, times } of this.points) {
      const own = mesh.geometry.attributes.position;
      let count = 0;
      for (const k of members) {
        if (!this.isShown(times[2 * k], times[2 * k + 1])) continue;
        own.array.set(places.subarray(3 * k, 3 * k + 3), 3 * count);
        mesh.put(count, colour(style, k), 1);
        count += 1;
      }
      mesh.geometry.setDrawRange(0, count);
      mesh.show();
    }
    this.shown = this.texts
      .filter((one) => this.isShown(...one.time))
      .slice(-MOST_TEXTS)
      .map((one) => [one, label(one)]);
    byId("texts").replaceChildren(...this.shown.map(([, element]) => element));
  }

  /** Return whether a marker is shown, and restrict the times until which nothing changes. */
  isShown(start, end) {
    const { time } = this.episode;
    for (const edge of [start, end]) {
      if (edge <= time) this.from = Math.max(this.from, edge);
      else this.until = Math.min(this.until, edge);
    }
    return start <= time && time < end;
  }

  /** Move the texts to their points; `project` returns the place of a position on the canvas. */
  placeTexts(project) {
    byId("texts").hidden = !this.visible;
    for (const [one, element] of this.shown) {
      const at = project(one.position);
      element.hidden = !at;
      if (at)
        element.style.transform = `translate(${at[0].toFixed(0)}px, ${at[1].toFixed(0)}px)`;
    }
  }

  paint() {}
}

/** Group the indices of markers by their size: [[size, indices], ...]. */
function groupsBySize(style) {
  const found = new Map();
  for (let k = 0; 4 * k < style.length; k += 1) {
    const size = style[4 * k + 3];
    if (!found.has(size)) found.set(size, []);
    found.get(size).push(k);
  }
  return [...found];
}

function colour(style, k) {
  return hue([style[4 * k] / 255, style[4 * k + 1] / 255, style[4 * k + 2] / 255]);
}

function label({ text, colour: [red, green, blue], size }) {
  const element = document.createElement("div");
  element.textContent = text;
  element.style.color = `rgb(${red}, ${green}, ${blue})`;
  element.style.fontSize = `${Math.max(size, 8)}px`;
  return element;
}
