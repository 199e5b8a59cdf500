// Orbit camera, controlled by mouse, touch and keys, which can follow a drone.

import { Matrix3, PerspectiveCamera, Vector3 } from "./three.module.min.js";

const FIELD_OF_VIEW = 50; // degrees
const MARGIN = 1.14; // factor of the distance at which the whole scene is just visible
const LOWEST = 0.02; // minimum elevation, rad

export class View {
  constructor(canvas, extent) {
    this.canvas = canvas;
    this.extent = extent;
    this.camera = new PerspectiveCamera(FIELD_OF_VIEW, 1, 0.1, 1000);
    this.camera.up.set(0, 0, 1);
    this.target = new Vector3();
    this.fingers = new Map();
    [this.changed, this.touched, this.height, this.free] = [true, false, 1, [1, 1]];
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => this.fingers.delete(event.pointerId));
    }
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.zoom(Math.exp(0.0012 * Math.max(-400, Math.min(400, event.deltaY))));
      },
      { passive: false },
    );
  }

  /** Show the whole scene, from the south-west and above. */
  whole() {
    const { middle, low, high } = this.extent;
    this.target.set(...middle);
    [this.azimuth, this.elevation, this.distance] = [-0.7 * Math.PI, 0.6, 1];
    this.update();
    // A corner is visible if its offset from the optical axis is within the field of view at its depth.
    const tangent = Math.tan((FIELD_OF_VIEW * Math.PI) / 360);
    const across = tangent * this.camera.aspect * this.free[0];
    const upright = tangent * this.free[1];
    const turned = new Matrix3().setFromMatrix4(this.camera.matrixWorld).transpose();
    for (let corner = 0; corner < 8; corner += 1) {
      const at = new Vector3(
        ...[0, 1, 2].map((axis) => ((corner >> axis) & 1 ? high : low)[axis] - middle[axis]),
      );
      at.applyMatrix3(turned);
      this.distance = Math.max(
        this.distance,
        MARGIN * Math.max(Math.abs(at.x) / across, Math.abs(at.y) / upright) + at.z,
      );
    }
    [this.changed, this.touched] = [true, false];
  }

  press(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.fingers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  drag(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const [right, down] = [now[0] - before[0], now[1] - before[1]];
    if (this.fingers.size > 1) {
      const [other] = [...this.fingers].filter(([id]) => id !== event.pointerId)[0].slice(1);
      const apart = (one) => Math.hypot(one[0] - other[0], one[1] - other[1]) || 1;
      this.zoom(apart(before) / apart(now));
      this.move(-0.5 * right, 0.5 * down);
    } else if (event.buttons & 2 || event.shiftKey) this.move(-right, down);
    else this.turn(-0.006 * right, 0.006 * down);
    this.fingers.set(event.pointerId, now);
  }

  turn(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.min(Math.max(this.elevation + elevation, LOWEST), Math.PI / 2 - 0.001);
    this.changed = this.touched = true;
  }

  zoom(factor) {
    this.distance = Math.min(Math.max(this.distance * factor, 0.05), 8 * this.extent.size);
    this.changed = this.touched = true;
  }

  /** Move the target by pixels, right and forward over the ground. */
  move(right, forward) {
    const metre = this.pixelAt(this.distance);
    const [cosine, sine] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    this.target.x += metre * (-sine * right - cosine * forward);
    this.target.y += metre * (cosine * right - sine * forward);
    this.changed = this.touched = true;
  }

  /** Zoom in on a drone. */
  approach(size) {
    this.distance = Math.min(this.distance, Math.max(12 * size, 0.008 * this.extent.size));
    this.changed = this.touched = true;
  }

  /** Size of a pixel at a distance, m. */
  pixelAt(distance) {
    return (2 * distance * Math.tan((FIELD_OF_VIEW * Math.PI) / 360)) / this.height;
  }

  /** Set the size of the canvas, of which panels cover some pixels on the right and below. */
  resize(width, height, right, below) {
    this.height = height;
    this.free = [1 - right / width, 1 - below / height];
    this.camera.aspect = width / height;
    this.camera.setViewOffset(width, height, right / 2, below / 2, width, height);
    this.changed = true;
  }

  update() {
    const { camera, target, distance } = this;
    const level = distance * Math.cos(this.elevation);
    camera.position.set(
      target.x + level * Math.cos(this.azimuth),
      target.y + level * Math.sin(this.azimuth),
      Math.max(0.02, target.z + distance * Math.sin(this.elevation)),
    );
    camera.lookAt(target);
    // The near plane scales with the distance, to avoid z-fighting of far faces.
    camera.near = Math.max(0.01, distance / 100);
    camera.far = distance + 30 * this.extent.size;
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
  }
}
