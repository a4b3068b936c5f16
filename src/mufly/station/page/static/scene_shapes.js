// Other vehicles than coaxial helicopters, of plain solids: x to the right, y up, z to the rear, lengths in rotor radii.
import { THREE } from "nicegui-scene";
import { helicopter } from "./scene_helicopter.js";

const { Group, Mesh } = THREE;

function rotorcraft(parts, arms) {
  const reach = 1.15, rotors = [];
  for (let k = 0; k < arms; k++) {
    const a = ((k + 0.5) / arms) * 2 * Math.PI, x = reach * Math.sin(a), z = -reach * Math.cos(a);
    parts.bar([0, 0, 0], [x, 0, z], 0.06, "dark");
    rotors.push(parts.disc(x, 0.12, z, 0.62));
  }
  parts.box(0.6, 0.24, 0.7, [0, 0, 0], "body");
  parts.box(0.2, 0.1, 0.2, [0, 0.06, -0.42], "nose");
  for (const x of [-0.35, 0.35]) parts.bar([x, -0.1, 0], [x, -0.4, 0], 0.04, "dark"), parts.bar([x, -0.4, -0.4], [x, -0.4, 0.4], 0.04, "dark");
  return rotors;
}
const SHAPES = {
  plane(parts) {
    parts.box(0.26, 0.26, 1.9, [0, 0, 0.15], "body");
    parts.box(0.2, 0.2, 0.3, [0, 0, -0.9], "nose");
    parts.box(2.8, 0.06, 0.5, [0, 0.1, -0.1], "light");
    parts.box(1.0, 0.05, 0.3, [0, 0.08, 1.0], "light");
    parts.box(0.05, 0.5, 0.3, [0, 0.3, 1.0], "light");
    return [parts.disc(0, 0, -1.08, 0.4, true)];
  },
  helicopter(parts) {
    parts.box(0.5, 0.5, 0.9, [0, -0.25, -0.1], "body");
    parts.box(0.34, 0.3, 0.2, [0, -0.28, -0.58], "nose");
    parts.bar([0, -0.1, 0.3], [0, -0.05, 1.4], 0.06, "dark");
    parts.box(0.04, 0.4, 0.2, [0, 0.05, 1.4], "light");
    parts.bar([0, 0, 0], [0, 0.25, 0], 0.05, "dark");
    for (const x of [-0.3, 0.3]) parts.bar([x, -0.7, -0.5], [x, -0.7, 0.5], 0.04, "dark"), parts.bar([x, -0.7, 0], [x * 0.7, -0.4, 0], 0.04, "dark");
    return [parts.disc(0, 0.28, 0, 1.0)];
  },
  rover(parts) {
    parts.box(0.8, 0.3, 1.4, [0, -0.35, 0], "body");
    parts.box(0.5, 0.2, 0.5, [0, -0.12, 0.1], "light");
    parts.box(0.3, 0.12, 0.12, [0, -0.32, -0.72], "nose");
    for (const x of [-0.48, 0.48]) for (const z of [-0.45, 0.45]) parts.wheel(x, -0.55, z, 0.25);
    return [];
  },
  boat(parts) {
    parts.box(0.6, 0.3, 1.3, [0, -0.6, 0.1], "body");
    parts.cone(0.42, 0.6, [0, -0.6, -0.85], "nose");
    parts.box(0.35, 0.25, 0.5, [0, -0.35, 0.25], "light");
    return [];
  },
  submarine(parts) {
    parts.box(0.5, 0.5, 1.5, [0, 0, 0], "body");
    parts.cone(0.35, 0.4, [0, 0, -0.95], "nose");
    parts.box(0.2, 0.3, 0.4, [0, 0.35, -0.1], "light");
    return [];
  },
  block(parts) {
    parts.box(0.7, 0.4, 1.0, [0, 0, 0], "body");
    parts.cone(0.3, 0.5, [0, 0, -0.75], "nose");
    return [];
  },
};
for (const [name, arms] of [["tricopter", 3], ["quadrotor", 4], ["hexarotor", 6], ["octorotor", 8], ["dodecarotor", 12]]) SHAPES[name] = (parts) => rotorcraft(parts, arms);

// kind: "coaxial", or a key of SHAPES; what is not known is a block with a nose.
export function vehicle(kind, radius, tint, options = {}) {
  if (kind === "coaxial" || !kind) return helicopter(radius, tint, options);
  const { ghost = false } = options, group = new Group(), own = [], see = ghost ? { transparent: true, opacity: 0.32, depthWrite: false } : {};
  const material = (color) => (own.push(new THREE.MeshStandardMaterial({ color: ghost ? tint : color, roughness: 0.5, ...see })), own.at(-1));
  const paint = { body: material(tint), dark: material(0x2b3138), light: material(0xd9dee3), nose: material(0xffc53d) };
  const put = (geometry, name, at) => {
    const mesh = new Mesh(geometry, paint[name]);
    mesh.position.set(...at);
    group.add(mesh);
    return mesh;
  };
  const parts = {
    box: (x, y, z, at, name) => put(new THREE.BoxGeometry(x, y, z), name, at),
    cone: (r, h, at, name) => (put(new THREE.ConeGeometry(r, h, 16), name, at).rotation.x = -Math.PI / 2),
    wheel: (x, y, z, r) => (put(new THREE.CylinderGeometry(r, r, 0.14, 20), "dark", [x, y, z]).rotation.z = Math.PI / 2),
    bar(from, to, r, name) {
      const a = new THREE.Vector3(...from), b = new THREE.Vector3(...to);
      const mesh = put(new THREE.CylinderGeometry(r / 2, r / 2, a.distanceTo(b), 8), name, a.clone().add(b).multiplyScalar(0.5).toArray());
      mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), b.sub(a).normalize());
    },
    disc(x, y, z, r, upright = false) {
      const holder = new Group(), turning = new Group();
      const blade = new Mesh(new THREE.BoxGeometry(2 * r, 0.02, 0.12), paint.light);
      const see = new THREE.MeshBasicMaterial({ color: tint, transparent: true, opacity: ghost ? 0.1 : 0.16, side: THREE.DoubleSide, depthWrite: false });
      own.push(see);
      const sweep = new Mesh(new THREE.RingGeometry(0.08, r, 32), see);
      sweep.rotation.x = -Math.PI / 2;
      turning.add(blade);
      holder.add(turning, sweep);
      holder.position.set(x, y, z);
      if (upright) holder.rotation.x = Math.PI / 2;
      group.add(holder);
      return { turning, sweep };
    },
  };
  const rotors = (SHAPES[kind] || SHAPES.block)(parts);
  group.scale.setScalar(radius);
  return {
    group,
    // What other vehicles' rotors do is not told: they turn while the motors may run.
    spin(upper, lower, seconds, running = false) {
      for (const [k, r] of rotors.entries()) {
        if (running) r.turning.rotation.y += (k % 2 ? -14 : 14) * seconds;
        r.sweep.visible = running;
      }
    },
    resize(r) {
      group.scale.setScalar(r);
    },
    dispose() {
      group.removeFromParent();
      group.traverse((o) => o.geometry?.dispose());
      own.forEach((m) => m.dispose());
    },
  };
}
