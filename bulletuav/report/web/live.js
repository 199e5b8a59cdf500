// Live pages: an episode that grows by server-sent events; report/live.py is the writer.

import { byId } from "./controls.js";
import { readPayload } from "./payload.js";

/** A typed array that grows. */
class Column {
  constructor(values) {
    [this.kept, this.length] = [values.slice(), values.length];
  }

  push(values) {
    const length = this.length + values.length;
    if (length > this.kept.length) {
      const grown = new this.kept.constructor(2 * length);
      grown.set(this.kept);
      this.kept = grown;
    }
    this.kept.set(values, this.length);
    this.length = length;
  }

  get values() {
    return this.kept.subarray(0, this.length);
  }
}

/** Values of a series of `payload.js`, row by row, from row `first` on. */
function rowsOf(series, first) {
  const parts = series.low.length;
  const values = new Float32Array((series.rows - first) * parts);
  for (let row = first, k = 0; row < series.rows; row += 1)
    for (let part = 0; part < parts; part += 1, k += 1) values[k] = series.at(row, part);
  return values;
}

/** A series that grows row by row, with the interface of a series of `payload.js`. */
class GrowingSeries {
  constructor(series, turns) {
    this.parts = series.low.length;
    this.turns = turns; // whether these are quaternions
    this.rows = new Column(new Float32Array(0));
    this.low = new Float32Array(this.parts).fill(Infinity);
    this.high = new Float32Array(this.parts).fill(-Infinity);
    this.push(rowsOf(series, 0));
  }

  push(values) {
    if (this.turns) this.align(values);
    this.rows.push(values);
    values.forEach((value, k) => {
      const part = k % this.parts;
      if (value < this.low[part]) this.low[part] = value;
      if (value > this.high[part]) this.high[part] = value;
    });
  }

  /** Choose the signs of quaternions so that they are close to the previous row. */
  align(values) {
    const { values: before } = this.rows;
    const from = before.length - values.length;
    if (from < 0) return;
    for (let k = 0; k < values.length; k += 4) {
      let dot = 0;
      for (let part = k; part < k + 4; part += 1) dot += values[part] * before[from + part];
      if (dot < 0) for (let part = k; part < k + 4; part += 1) values[part] *= -1;
    }
  }

  get step() {
    return this.low.map((low, part) => Math.max(0, this.high[part] - low) / 65534);
  }

  at(row, part) {
    return this.rows.kept[row * this.parts + part];
  }

  between(row, share, out) {
    const { kept, length } = this.rows;
    const from = row * this.parts;
    const to = from + this.parts < length ? from + this.parts : from;
    for (let part = 0; part < this.parts; part += 1)
      out[part] = kept[from + part] + share * (kept[to + part] - kept[from + part]);
  }
}

const COLUMNS = ["time", "conflict", "seen", "contact_row", "contact_point", "link_drone"];
COLUMNS.push("link_target", "link_start");

/** A payload that grows. Updates have two rows, the first of which is known. */
export class LivePayload {
  constructor(payload) {
    this.about = payload.about;
    this.fixed = payload;
    this.grows = true;
    this.columns = new Map(COLUMNS.map((name) => [name, new Column(payload.array(name))]));
    this.lines = new Map();
    for (const name of Object.keys(this.about.arrays).filter((one) => one.endsWith(" codes"))) {
      const own = name.slice(0, -" codes".length);
      const series = new GrowingSeries(payload.series(own), own.endsWith("quaternion"));
      this.lines.set(own, series);
    }
    // Number of decisions that each drone has flown, plus one for drones that still fly.
    this.flown = payload.array("end").slice();
    this.end = this.flown.map((count) => (count === this.about.rows - 1 ? count + 1 : count));
  }

  append(news) {
    const { about } = this;
    const array = (name) => news.array(name);
    const add = (name, values) => this.columns.get(name).push(values);
    add("time", array("time").subarray(1));
    add("conflict", array("conflict").subarray(about.drones));
    add("seen", array("seen").subarray(about.users));
    add("contact_row", array("contact_row").map((row) => row + about.rows - 1));
    add("contact_point", array("contact_point"));
    const [, first, last] = array("link_start");
    const links = this.columns.get("link_drone").length;
    add("link_drone", array("link_drone").subarray(first));
    add("link_target", array("link_target").subarray(first));
    add("link_start", [links + last - first]);
    for (const [name, series] of this.lines) {
      // Readings that are missing in this update have no value.
      if (news.has(name)) series.push(rowsOf(news.series(name), 1));
      else series.push(new Float32Array(series.parts).fill(NaN));
    }
    const flew = array("end");
    this.flown = this.flown.map((count, k) => count + flew[k]);
    this.end = this.flown.map((count, k) => count + flew[k]);
    about.rows += 1;
  }

  /** Mark the episode as complete. */
  finish() {
    [this.grows, this.end] = [false, this.flown];
  }

  array(name) {
    if (name === "end") return this.end;
    return this.columns.get(name)?.values ?? this.fixed.array(name);
  }

  has(name) {
    return this.lines.has(name);
  }

  series(name) {
    return this.lines.get(name);
  }
}

/** Show the server's events; `begin` creates the player of the first episode. */
export function listen(begin, fail) {
  const source = new EventSource("feed");
  let player = null;
  let turn = Promise.resolve();
  const showStatus = (text) => {
    byId("feed").hidden = false;
    byId("feed").textContent = text;
  };
  // Events are handled in order, as decoding is asynchronous.
  const take = (name, act) =>
    source.addEventListener(name, (event) => {
      turn = turn.then(() => act(event.data)).catch(fail);
    });
  take("start", async (data) => {
    const payload = new LivePayload(await readPayload(data));
    if (player) player.load(payload);
    else player = begin(payload);
    showStatus("Live");
  });
  take("rows", async (data) => {
    player.episode.payload.append(await readPayload(data));
    player.grow();
  });
  take("over", () => {
    source.close();
    player?.finish();
    showStatus("The flight is over");
  });
  source.addEventListener("open", () => showStatus("Waiting for the flight"));
  source.addEventListener("error", () => showStatus("Connection lost: reconnecting"));
}
