// State of the episode at any time: positions of drones, goals, obstacles and users, interpolated.

/** Interpolated episode; `sample` updates its arrays to a time. */
export class Episode {
  constructor(payload) {
    const { about } = payload;
    this.payload = payload;
    this.about = about;
    // Drones with attitude, track, goal and plots, the first ones; live pages have all
    this.detailed = about.detailed.length;
    this.read();
    this.start = this.times[0];
    this.period = about.rows > 1 ? this.times[1] - this.start : 1;
    this.moving = ["position", "quaternion", "goal", "obstacle", "obstacle_quaternion", "target"];
    for (const name of this.moving) this[name] = new Float32Array(payload.series(name).low.length);
    this.rotors = payload.series("rotors");
    this.forward = payload.has("forward rotors") ? payload.series("forward rotors") : undefined;
    this.sample(this.start);
  }

  /** Read rows that have been added; replays have all rows from the start. */
  read() {
    for (const name of ["end", "conflict", "seen"]) this[name] = this.payload.array(name);
    this.times = this.payload.array("time");
    this.duration = this.times[this.about.rows - 1];
  }

  /** Interpolate all arrays at a time, s. */
  sample(time) {
    const last = this.about.rows - 1;
    this.time = Math.min(Math.max(time, this.start), this.duration);
    let place = Math.min((this.time - this.start) / this.period, last);
    // The last interval of sampled rows may be shorter.
    if (place > last - 1 && last > 0) {
      const before = this.times[last - 1];
      place = last - 1 + Math.max(0, this.time - before) / (this.duration - before);
    }
    // The tolerance prevents rounding from selecting the previous row.
    this.row = Math.min(Math.floor(place + 1e-4), last);
    this.share = Math.max(0, place - this.row);
    // Data of a decision are stored at its final row and hold during the decision.
    this.decision = Math.min(Math.ceil(place - 1e-4), last);
    for (const name of this.moving)
      this.payload.series(name).between(this.row, this.share, this[name]);
  }

  flies(drone) {
    return this.row < this.end[drone];
  }

  inConflict(drone) {
    return this.flies(drone) && this.conflict[this.decision * this.about.drones + drone] === 1;
  }

  isSeen(user) {
    return this.seen[this.row * this.about.users + user] === 1;
  }

  /** Mean speed of a drone's rotors along z, or along x, rad/s. */
  rotorSpeed(drone, isForward) {
    return this.flies(drone) ? (isForward ? this.forward : this.rotors).at(this.row, drone) : 0;
  }

  /** Minimum and maximum x, y, z of all moving objects: [[x, y, z], [x, y, z]]. */
  bounds() {
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    for (const name of ["position", "goal", "target", "obstacle"]) {
      const { low: least, step } = this.payload.series(name);
      for (let part = 0; part < least.length; part += 1) {
        low[part % 3] = Math.min(low[part % 3], least[part]);
        high[part % 3] = Math.max(high[part % 3], least[part] + 65534 * step[part]);
      }
    }
    return [low, high];
  }
}
