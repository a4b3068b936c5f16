// A coaxial micro helicopter as a model of its own axes: x to the right, y up, z to the rear.
//
// Every length is a share of the rotor radius: fuselage, four legs, mast, two rotors of two blades, stabiliser bar on top.
import { THREE } from "nicegui-scene";

const { Group, Mesh } = THREE;

function lathe(points, material) {
  return new Mesh(new THREE.LatheGeometry(points.map(([r, y]) => new THREE.Vector2(r, y)), 24), material);
}

function rod(radius, from, to, material) {
  const a = new THREE.Vector3(...from), b = new THREE.Vector3(...to);
  const mesh = new Mesh(new THREE.CylinderGeometry(radius, radius, a.distanceTo(b), 8), material);
  mesh.position.copy(a).add(b).multiplyScalar(0.5);
  mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), b.clone().sub(a).normalize());
  return mesh;
}

function rotor(height, material, disc) {
  const group = new Group();
  group.position.y = height;
  for (const turn of [0, Math.PI]) {
    const blade = new Mesh(new THREE.BoxGeometry(0.86, 0.018, 0.15), material);
    blade.position.x = 0.54;
    blade.rotation.x = 0.2;
    const holder = new Group();
    holder.rotation.y = turn;
    holder.add(blade);
    group.add(holder);
  }
  const sweep = new Mesh(new THREE.RingGeometry(0.1, 1, 48), disc);
  sweep.rotation.x = -Math.PI / 2;
  group.add(sweep);
  return group;
}

export function helicopter(radius, tint, { ghost = false } = {}) {
  const group = new Group(), own = [];
  const keep = (m) => (own.push(m), m);
  const see = ghost ? { transparent: true, opacity: 0.32, depthWrite: false } : {};
  const body = keep(new THREE.MeshStandardMaterial({ color: tint, roughness: 0.45, metalness: 0.1, ...see }));
  const dark = keep(new THREE.MeshStandardMaterial({ color: ghost ? tint : 0x2b3138, roughness: 0.6, ...see }));
  const light = keep(new THREE.MeshStandardMaterial({ color: ghost ? tint : 0xd9dee3, roughness: 0.5, ...see }));
  const nose = keep(new THREE.MeshStandardMaterial({ color: ghost ? tint : 0xffc53d, roughness: 0.4, ...see }));
  const blur = () => keep(new THREE.MeshBasicMaterial({
    color: tint, transparent: true, opacity: 0.0, side: THREE.DoubleSide, depthWrite: false,
  }));
  const shell = lathe([[0.001, -0.62], [0.2, -0.6], [0.31, -0.45], [0.33, -0.25], [0.26, -0.02], [0.1, 0.14], [0.001, 0.16]], body);
  group.add(shell);
  const ring = new Mesh(new THREE.TorusGeometry(0.335, 0.03, 8, 32), dark);
  ring.rotation.x = Math.PI / 2;
  ring.position.y = -0.33;
  group.add(ring);
  const eye = new Mesh(new THREE.SphereGeometry(0.13, 16, 12), nose);
  eye.position.set(0, -0.3, -0.29);
  group.add(eye);
  group.add(rod(0.035, [0, 0.1, 0], [0, 0.86, 0], dark));
  for (const [x, z] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) {
    group.add(rod(0.022, [0.17 * x, -0.42, 0.17 * z], [0.42 * x, -0.8, 0.42 * z], dark));
    const foot = new Mesh(new THREE.SphereGeometry(0.04, 8, 8), dark);
    foot.position.set(0.42 * x, -0.8, 0.42 * z);
    group.add(foot);
  }
  const upper = rotor(0.66, light, blur()), lower = rotor(0.3, light, blur());
  const bar = new Group();
  bar.add(rod(0.018, [-0.55, 0, 0], [0.55, 0, 0], dark));
  for (const x of [-0.55, 0.55]) {
    const weight = new Mesh(new THREE.SphereGeometry(0.055, 10, 8), dark);
    weight.position.x = x;
    bar.add(weight);
  }
  bar.position.y = 0.2;
  bar.rotation.y = Math.PI / 2;
  upper.add(bar);
  group.add(upper, lower);
  group.scale.setScalar(radius);
  return {
    group,
    // Rotors cannot be shown at 60 turns a second on a screen of 60 pictures a second: they turn slowly and blur.
    spin(upperSpeed, lowerSpeed, seconds) {
      upper.rotation.y += 0.035 * upperSpeed * seconds;
      lower.rotation.y -= 0.035 * lowerSpeed * seconds;
      if (ghost) return;
      upper.children[2].material.opacity = Math.min(0.22, upperSpeed / 1800);
      lower.children[2].material.opacity = Math.min(0.22, lowerSpeed / 1800);
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

const m = new THREE.Matrix4();

// Attitude (roll, pitch, yaw; rad; body x forward, y right, z down in N-E-D) as the scene's axes: x east, y up, z south.
export function turn(object, roll, pitch, yaw) {
  const cr = Math.cos(roll), sr = Math.sin(roll), cp = Math.cos(pitch), sp = Math.sin(pitch);
  const cy = Math.cos(yaw), sy = Math.sin(yaw);
  const r = [
    [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
    [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
    [-sp, sr * cp, cr * cp],
  ];
  m.set(
    r[1][1], -r[1][2], -r[1][0], 0,
    -r[2][1], r[2][2], r[2][0], 0,
    -r[0][1], r[0][2], r[0][0], 0,
    0, 0, 0, 1,
  );
  object.quaternion.setFromRotationMatrix(m);
}

export const place = (object, n, e, d) => object.position.set(e, -d, -n);
