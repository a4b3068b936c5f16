"""Drag of rotors in their disc plane, from blade elements at hover: the source of `rotors.inplane_drag` of
a vehicle.

Blade elements of both rotors are solved at the vehicle's hover speeds, pitches such that each rotor carries what the
vehicle file's coefficients say. The derivation stands in docs/explanation/dynamics.md. Lift and drag slopes are those
of the same blade elements half a degree of pitch to either side.

python benchmarks/rotor_drag.py [--vehicle mufly-1.1] [--rotor walkera-5g6]
"""

import argparse

import numpy as np
from scipy.optimize import root

from mufly.dynamics import find_trim
from mufly.rotor import Air, OperatingCondition, RotorSystem, load_rotor, solve_system
from mufly.vehicle import load_vehicle

NUDGE = np.radians(0.5)


def drag(point, lower_pitch, higher_pitch, radius, blades, rho):
    """C_H / mu of one rotor from lift, from drag across and from drag along the blades; blow-back a1 / mu (rad)."""
    c, dr, cl, cd, phi, r = point.chord_m, point.dr_m, point.cl, point.cd, point.phi_rad, point.r_m
    W = point.reynolds * Air().viscosity_Pa_s / rho / c
    along, axial = W * np.cos(phi), W * np.sin(phi)
    turned = (higher_pitch.theta_rad - higher_pitch.phi_rad) - (lower_pitch.theta_rad - lower_pitch.phi_rad)
    cl_a, cd_a = (higher_pitch.cl - lower_pitch.cl) / turned, (higher_pitch.cd - lower_pitch.cd) / turned
    lift = along / W * cl * axial + cl_a * axial**2 / W
    across = along / W * cd * along + W * cd + cd_a * axial * along / W
    spanwise = W * cd
    share = blades * 0.25 * rho * c * dr / (rho * np.pi * radius**3 * point.speed_rad_s)
    # Blow-back of a freely flapping disc: the tilt whose cyclic change of angle gives back the moment that lift on
    # the advancing side makes.
    more = r * 0.5 * rho * c * dr * (2 * along * cl + cl_a * axial)  # d(moment)/dU_T
    tilt = r * 0.5 * rho * c * dr * cl_a * along * W  # d(moment)/d(angle)
    return (*(float(np.sum(share * part)) for part in (lift, across, spanwise)),
            float(np.sum(more) / np.sum(tilt)) * point.speed_rad_s * radius)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicle", default="mufly-1.1")
    parser.add_argument("--rotor", default="walkera-5g6")
    asked = parser.parse_args()
    vehicle, rotor = load_vehicle(asked.vehicle), load_rotor(asked.rotor)
    hover = find_trim(vehicle)
    rho, radius = float(vehicle.air.density), float(vehicle.rotors.radius)
    air = Air(density_kg_m3=rho)
    apart = float(vehicle.rotors.lower.hub_z) - float(vehicle.rotors.upper.hub_z)
    pair = RotorSystem.coaxial_pair(rotor, rotor, spacing_m=apart)

    def at(pitch):
        return solve_system(pair, OperatingCondition(tuple(pitch), speed_rad_s=tuple(hover.rotor_speed), air=air))

    found = root(lambda x: np.array([r.thrust_N for r in at(x).rotors]) / hover.thrust_N - 1.0, [0.2, 0.2])
    points, less, more = at(found.x), at(found.x - NUDGE), at(found.x + NUDGE)
    total, speeds = [], hover.rotor_speed
    for k, side in enumerate(("upper", "lower")):
        lift, across, spanwise, blow = drag(points.rotors[k], less.rotors[k], more.rotors[k], radius, rotor.blades, rho)
        total.append(lift + across + spanwise)
        thrust = points.rotors[k].c_T
        print(
            f"{side}: pitch {np.degrees(found.x[k]):.1f} deg, c_T {thrust:.4f}; C_H / mu {total[-1]:.5f} (lift "
            f"{lift:.5f}, drag across the blades {across:.5f}, along them {spanwise:.5f}); blow-back of free "
            f"flapping {blow:.3f} rad per mu, as much as C_H / mu {thrust * blow:.5f}"
        )
    mean = float(np.dot(total, speeds) / np.sum(speeds))
    force = mean * rho * np.pi * radius**3 * float(np.sum(speeds))
    print(f"inplane_drag {mean:.5f}: {force * 1e3:.2f} mN per m/s at hover")


if __name__ == "__main__":
    main()
