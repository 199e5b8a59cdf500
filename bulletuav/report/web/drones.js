// Drones: bodies, spinning propellers, d_safe circles, lines to the ground, goals, contacts.

import {
  BoxGeometry,
  CircleGeometry,
  Color,
  DoubleSide,
  Group,
  InstancedBufferAttribute,
  InstancedMesh,
  MeshBasicMaterial,
  MeshLambertMaterial,
  OctahedronGeometry,
  Quaternion,
  Vector3,
} from "./three.module.min.js";
import { Discs, Lines, Rings, Trails } from "./lines.js";
import { hue, joined, pose, shapeGeometry, writePose } from "./shapes.js";

const CYLINDER = 1; // kind in geometry/shapes.py
const SMALLEST = { drone: 26, goal: 9, contact: 9, disc: 4 }; // minimum sizes, pixels
const CROWDED = 13; // minimum size of drones with details among others, pixels
const TURNS = 3; // displayed revolutions per second of a propeller at 1,000 rad/s: slow enough to be visible
const FORWARD = new Quaternion(0, Math.SQRT1_2, 0, Math.SQRT1_2); // turns z to x
const GREY = new Color(0.5, 0.5, 0.5);
const MOST_CONTACTS = 256;
const CONTACT_TIME = 1.5; // duration for which a contact is shown, s

function instances(geometry, material, count, coloured = true) {
  const mesh = new InstancedMesh(geometry, material, count);
  mesh.frustumCulled = false;
  if (coloured)
    mesh.instanceColor = new InstancedBufferAttribute(new Float32Array(3 * count).fill(1), 3);
  return mesh;
}

/** Split the parts of an airframe into its body and the discs that represent propellers. */
function looks({ parts, rotors, propeller_radius: radius, forward = [], heights = [] }) {
  const isDisc = (part) =>
    part.kind === CYLINDER && part.half[2] < 0.2 * part.half[0] && part.half[0] > 0.5 * radius;
  const body = parts.filter((part) => !isDisc(part));
  const tops = parts.map((part) => part.position[2] + (isDisc(part) ? 0 : part.half[2]));
  const discs = parts.map((part, k) => [isDisc(part), tops[k]]).filter(([is]) => is);
  const height = discs.length ? discs[0][1] : Math.max(...tops);
  const shown = (body.length ? body : parts).map((part) => ({
    geometry: shapeGeometry(part),
    matrix: pose(part.position, part.quaternion),
    hue: hue(part.colour),
  }));
  const places = rotors.map(([x, y, turn], k) => ({
    x,
    y,
    z: heights[k] ?? height,
    turn,
    isForward: forward.includes(k),
  }));
  return { body: joined(shown), places, radius };
}

/** All drones of one airframe. */
class Fleet extends Group {
  constructor(airframe, members, colours) {
    super();
    const { body, places, radius } = looks(airframe);
    this.members = members;
    this.colours = members.map((k) => new Color(colours[k]));
    this.places = places;
    this.hasForward = places.some((place) => place.isForward);
    this.size = 2 * airframe.radius;
    // Discs have the drone's colour; the front ones are brighter, to show the heading.
    const white = (share) => new Color(share, share, share);
    const disc = joined(
      places.map(({ x, y, z, isForward }) => ({
        geometry: new CircleGeometry(radius, 20),
        matrix: pose([x, y, z], isForward ? FORWARD.toArray() : undefined),
        hue: white(x > 1e-9 ? 1 : 0.55),
      })),
    );
    const blade = joined([
      {
        geometry: new BoxGeometry(1.9 * radius, 0.2 * radius, 0.04 * radius),
        matrix: pose([0, 0, 0]),
        hue: white(1),
      },
    ]);
    this.bodies = instances(
      body,
      new MeshLambertMaterial({ vertexColors: true }),
      members.length,
      false,
    );
    this.discs = instances(
      disc,
      new MeshBasicMaterial({
        vertexColors: true,
        transparent: true,
        opacity: 0.8,
        side: DoubleSide,
        depthWrite: false,
      }),
      members.length,
    );
    this.blades = instances(
      blade,
      new MeshBasicMaterial({ color: 0x22262c }),
      members.length * places.length,
      false,
    );
    this.angle = new Float32Array(members.length); // of rotors along z
    this.forwardAngle = new Float32Array(members.length);
    this.add(this.bodies, this.discs, this.blades);
    this.spot = new Vector3();
    this.turn = new Quaternion();
    this.ahead = new Quaternion();
  }

  update(episode, scales, seconds) {
    const { position: p, quaternion: q } = episode;
    const out = this.bodies.instanceMatrix.array;
    const blades = this.blades.instanceMatrix.array;
    for (let m = 0; m < this.members.length; m += 1) {
      const k = this.members[m];
      const [i, j] = [3 * k, 4 * k];
      const flies = episode.flies(k);
      this.turn.set(q[j], q[j + 1], q[j + 2], q[j + 3]).normalize();
      const { x, y, z, w } = this.turn;
      const scale = scales[k] * (flies ? 1 : 0.7);
      writePose(out, 16 * m, p[i], p[i + 1], p[i + 2], x, y, z, w, scale);
      const perSpeed = seconds * TURNS * 2 * Math.PI * 1e-3;
      this.angle[m] += perSpeed * episode.rotorSpeed(k, false);
      if (this.hasForward) {
        this.forwardAngle[m] += perSpeed * episode.rotorSpeed(k, true);
        this.ahead.copy(this.turn).multiply(FORWARD);
      }
      for (let r = 0; r < this.places.length; r += 1) {
        const place = this.places[r];
        this.spot.set(place.x, place.y, place.z).applyQuaternion(this.turn).multiplyScalar(scale);
        // The drag torque of a rotor acts on the body opposite to its spin.
        const angle = place.isForward ? this.forwardAngle[m] : this.angle[m];
        const half = -0.5 * place.turn * (angle + r);
        const [s, c] = [Math.sin(half), Math.cos(half)];
        const { x, y, z, w } = place.isForward ? this.ahead : this.turn;
        writePose(
          blades,
          16 * (m * this.places.length + r),
          p[i] + this.spot.x,
          p[i + 1] + this.spot.y,
          p[i + 2] + this.spot.z,
          x * c + y * s,
          y * c - x * s,
          z * c + w * s,
          w * c - z * s,
          scale,
        );
      }
      (flies ? this.colours[m] : GREY).toArray(this.discs.instanceColor.array, 3 * m);
    }
    this.discs.instanceMatrix.array.set(out);
    for (const mesh of [this.bodies, this.discs, this.blades])
      mesh.instanceMatrix.needsUpdate = true;
    this.discs.instanceColor.needsUpdate = true;
  }
}

export class Drones extends Group {
  constructor(episode) {
    super();
    this.episode = episode;
    const { about } = episode;
    const { airframes, airframe_of: kinds, colours } = about;
    this.count = episode.detailed;
    this.scales = new Float32Array(this.count).fill(1);
    this.smallest = this.count < about.drones ? CROWDED : SMALLEST.drone;
    this.fleets = airframes.map(
      (one, kind) =>
        new Fleet(
          one,
          [...kinds.keys()].filter((k) => kinds[k] === kind && k < this.count),
          colours,
        ),
    );
    this.sizes = kinds.map((kind) => 2 * airframes[kind].radius);
    this.trails = new Trails(episode);
    this.rings = new Rings(this.count, 0.5 * about.d_safe);
    this.stems = new Lines(this.count + 1, 1, 0.6);
    const widest = 2 * Math.max(...airframes.map((one) => one.radius));
    this.crowd = new Discs(episode.position, this.count, widest, SMALLEST.disc);
    this.goals = instances(
      new OctahedronGeometry(1),
      new MeshLambertMaterial(),
      Math.max(1, about.goals),
    );
    this.goals.count = about.goals;
    this.contacts = instances(
      new OctahedronGeometry(1),
      new MeshBasicMaterial(),
      MOST_CONTACTS,
      false,
    );
    this.hues = colours.map((one) => new Color(one));
    this.add(...this.fleets, this.crowd, this.trails, this.rings, this.stems, this.goals, this.contacts);
  }

  /** Update to the episode's time; `pixel(x, y, z)` returns the size of a pixel at a point, m. */
  update({ pixel, seconds, reach, chosen, trueSize }) {
    const { position: p } = this.episode;
    for (let k = 0; k < this.count; k += 1) {
      const least = this.smallest * pixel(p[3 * k], p[3 * k + 1], p[3 * k + 2]);
      this.scales[k] = trueSize ? 1 : Math.max(1, least / this.sizes[k]);
    }
    for (const fleet of this.fleets) fleet.update(this.episode, this.scales, seconds);
    this.placeCrowd();
    this.trails.update(reach);
    this.placeRings();
    this.placeStems(chosen);
    this.placeGoals(pixel);
    this.placeContacts(pixel);
  }

  /** Show the drones without attitudes as discs. */
  placeCrowd() {
    for (let k = this.count; k < this.episode.about.drones; k += 1) {
      if (!this.episode.flies(k)) this.crowd.put(k, GREY, 0.6);
      else if (this.episode.inConflict(k)) this.crowd.put(k, this.palette.conflict, 2);
      else this.crowd.put(k, this.hues[k], 1);
    }
    this.crowd.show();
  }

  placeRings() {
    const { position: p } = this.episode;
    for (let k = 0; k < this.count; k += 1) {
      const isNear = this.episode.inConflict(k);
      const thick = this.episode.flies(k) ? (isNear ? 3 : 1.2) : 0;
      this.rings.put(k, p, isNear ? this.palette.conflict : this.palette.ring, thick);
    }
    this.rings.show(this.count);
  }

  /** Place lines from drones to the ground, and from the selected drone to its goal. */
  placeStems(chosen) {
    const { position: p, goal, about } = this.episode;
    const foot = [0, 0, 0];
    let count = 0;
    for (let k = 0; k < this.count; k += 1) {
      if (!this.episode.flies(k)) continue;
      foot[0] = p[3 * k];
      foot[1] = p[3 * k + 1];
      this.stems.put(count, p, 3 * k, foot, 0, this.palette.ring);
      count += 1;
    }
    if (about.goals > chosen && this.episode.flies(chosen)) {
      this.stems.put(count, p, 3 * chosen, goal, 3 * chosen, this.palette.goal);
      count += 1;
    }
    this.stems.show(count);
  }

  placeGoals(pixel) {
    const { goal, about } = this.episode;
    for (let k = 0; k < about.goals; k += 1) {
      const size = Math.max(
        0.3 * this.sizes[0],
        0.5 * SMALLEST.goal * pixel(goal[3 * k], goal[3 * k + 1], goal[3 * k + 2]),
      );
      writePose(
        this.goals.instanceMatrix.array,
        16 * k,
        goal[3 * k],
        goal[3 * k + 1],
        goal[3 * k + 2],
        0,
        0,
        0,
        1,
        size,
      );
      this.hues[k].toArray(this.goals.instanceColor.array, 3 * k);
    }
    this.goals.instanceMatrix.needsUpdate = true;
  }

  placeContacts(pixel) {
    const { payload, row, period } = this.episode;
    const [rows, points] = ["contact_row", "contact_point"].map((name) => payload.array(name));
    let count = 0;
    // Latest contacts first; contacts are in chronological order.
    let k = rows.length - 1;
    while (k >= 0 && rows[k] > row) k -= 1;
    for (; k >= 0 && count < MOST_CONTACTS && (row - rows[k]) * period <= CONTACT_TIME; k -= 1) {
      const [x, y, z] = [points[3 * k], points[3 * k + 1], points[3 * k + 2]];
      writePose(
        this.contacts.instanceMatrix.array,
        16 * count,
        x,
        y,
        z,
        0,
        0,
        0,
        1,
        0.5 * SMALLEST.contact * pixel(x, y, z),
      );
      count += 1;
    }
    this.contacts.count = count;
    this.contacts.instanceMatrix.needsUpdate = true;
  }

  paint(palette) {
    this.palette = palette;
    this.contacts.material.color = palette.contact;
    // Dark bodies must be visible on dark ground, too.
    for (const fleet of this.fleets) fleet.bodies.material.emissive = palette.glow;
  }
}
