// Users on the ground, links to their serving drones, the selected drone's range finder beams, and
// cables.

import {
  CylinderGeometry,
  Group,
  InstancedBufferAttribute,
  InstancedMesh,
  MeshLambertMaterial,
  SphereGeometry,
  Color,
} from "./three.module.min.js";
import { Lines } from "./lines.js";
import { joined, pose, writePose } from "./shapes.js";

const TALL = 1.7; // height of a user, m
const SMALLEST = 13; // minimum size of a user, pixels

function person() {
  const white = new Color(1, 1, 1);
  const body = new CylinderGeometry(0.14, 0.24, 1.3, 8).rotateX(Math.PI / 2);
  return joined([
    { geometry: body, matrix: pose([0, 0, 0.65]), hue: white },
    { geometry: new SphereGeometry(0.2, 8, 6), matrix: pose([0, 0, 1.5]), hue: white },
  ]);
}

export class Service extends Group {
  constructor(episode) {
    super();
    this.episode = episode;
    const { about, payload } = episode;
    // Static targets may be cells of the ground: only moving ones are drawn as people.
    this.walk = payload.series("target").step.some((step) => step > 0);
    const figure = this.walk ? person() : new SphereGeometry(0.5, 10, 8);
    this.users = new InstancedMesh(figure, new MeshLambertMaterial(), Math.max(1, about.users));
    this.users.instanceColor = new InstancedBufferAttribute(
      new Float32Array(3 * Math.max(1, about.users)),
      3,
    );
    this.users.frustumCulled = false;
    this.users.count = about.users;
    this.links = new Lines(1, 1.5, 0.75);
    this.hasLinks = payload.grows ? about.users > 0 : payload.array("link_drone").length > 0;
    this.ranges = payload.has("reading/lidar") ? payload.series("reading/lidar") : null;
    const directions = about.lidar.beams.map(([azimuth, elevation]) => {
      const [a, e] = [(azimuth * Math.PI) / 180, (elevation * Math.PI) / 180];
      return [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
    });
    this.directions = directions;
    this.beams = new Lines(Math.max(1, directions.length), 1.5, 0.8);
    this.ends = payload.has("cable") ? payload.series("cable") : null;
    this.cables = new Lines(this.ends ? this.ends.low.length / 6 : 1, 2, 1);
    this.add(this.users, this.links, this.beams, this.cables);
  }

  update({ pixel, chosen, trueSize }) {
    this.placeUsers(pixel, trueSize);
    this.placeLinks();
    this.placeBeams(chosen);
    if (this.ends) this.placeCables();
  }

  placeUsers(pixel, trueSize) {
    const { target: at, about } = this.episode;
    for (let k = 0; k < about.users; k += 1) {
      const [x, y, z] = [at[3 * k], at[3 * k + 1], at[3 * k + 2]];
      const scale = trueSize ? 1 : Math.max(1, (SMALLEST * pixel(x, y, z)) / TALL);
      // Targets are at the height of the user's device: figures stand on the ground below.
      const foot = this.walk ? Math.max(0, z - TALL) : z;
      writePose(this.users.instanceMatrix.array, 16 * k, x, y, foot, 0, 0, 0, 1, scale);
      const colour = this.episode.isSeen(k) ? this.palette.seen : this.palette.unseen;
      colour.toArray(this.users.instanceColor.array, 3 * k);
    }
    this.users.instanceMatrix.needsUpdate = true;
    this.users.instanceColor.needsUpdate = true;
  }

  placeLinks() {
    const { payload, position, target, row } = this.episode;
    const [drones, users, begins] = ["link_drone", "link_target", "link_start"].map((name) =>
      payload.array(name),
    );
    const first = begins[row];
    const count = begins[row + 1] - first;
    if (count > this.links.most) this.links.grow(2 * count);
    for (let k = 0; k < count; k += 1) {
      const [from, to] = [3 * drones[first + k], 3 * users[first + k]];
      this.links.put(k, position, from, target, to, this.palette.link);
    }
    this.links.show(count);
  }

  placeBeams(chosen) {
    const { position: p, quaternion: q, about, row } = this.episode;
    if (!this.ranges || !this.episode.flies(chosen)) {
      this.beams.show(0);
      return;
    }
    let [cosine, sine] = [1, 0];
    if (about.lidar.frame === "yaw") {
      // The heading is the horizontal direction of the body's x axis.
      const [x, y, z, w] = q.subarray(4 * chosen, 4 * chosen + 4);
      const [east, north] = [1 - 2 * (y * y + z * z), 2 * (x * y + z * w)];
      const level = Math.hypot(east, north) || 1;
      [cosine, sine] = [east / level, north / level];
    }
    const end = [0, 0, 0];
    const count = this.directions.length;
    for (let k = 0; k < count; k += 1) {
      const [x, y, z] = this.directions[k];
      const range = this.ranges.at(row, chosen * count + k);
      end[0] = p[3 * chosen] + range * (cosine * x - sine * y);
      end[1] = p[3 * chosen + 1] + range * (sine * x + cosine * y);
      end[2] = p[3 * chosen + 2] + range * z;
      const hits = range < 0.9999 * about.lidar.max_range;
      this.beams.put(k, p, 3 * chosen, end, 0, hits ? this.palette.beam : this.palette.miss);
    }
    this.beams.show(count);
  }

  placeCables() {
    const { row, share, about } = this.episode;
    const next = Math.min(row + 1, about.rows - 1);
    const place = new Float32Array(6);
    let count = 0;
    for (let part = 0; part < this.ends.low.length; part += 6) {
      for (let k = 0; k < 6; k += 1) {
        const now = this.ends.at(row, part + k);
        place[k] = now + share * (this.ends.at(next, part + k) - now);
      }
      // Entries without a cable have no ends.
      if (Number.isNaN(place[0])) continue;
      this.cables.put(count, place, 0, place, 3, this.palette.cable);
      count += 1;
    }
    this.cables.show(count);
  }

  paint(palette) {
    this.palette = palette;
  }
}
