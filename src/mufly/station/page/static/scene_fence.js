// The geofence in the scene: walls of lines around what to keep in, red areas of what to keep out.
import { THREE } from "nicegui-scene";
import { colours } from "./draw.js";
import { lines } from "./scene_world.js";

const OPEN_M = 2.5; // drawn so high where there is no ceiling

export function fence(world) {
  const group = new THREE.Group(), f = world.fence;
  if (!f) return group;
  const high = f.ceiling ?? OPEN_M;
  for (const zone of f.zones) {
    const colour = zone.in ? colours.good : colours.bad, at = [], every = Math.max(1, Math.floor(zone.p.length / 12));
    zone.p.forEach(([n, e], k) => {
      const [nn, ee] = zone.p[(k + 1) % zone.p.length];
      at.push([n, e, 0], [nn, ee, 0], [n, e, -high], [nn, ee, -high]);
      if (k % every === 0) at.push([n, e, 0], [n, e, -high]);
    });
    group.add(lines(at, colour, { pairs: true, opacity: 0.8 }));
    if (zone.in) continue;
    const shape = new THREE.Shape(zone.p.map(([n, e]) => new THREE.Vector2(e, n)));
    const area = new THREE.Mesh(new THREE.ShapeGeometry(shape), new THREE.MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.18, side: THREE.DoubleSide, depthWrite: false }));
    area.rotation.x = -Math.PI / 2;
    area.position.y = 0.004;
    group.add(area);
  }
  return group;
}
