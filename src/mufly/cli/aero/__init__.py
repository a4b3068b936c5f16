"""``mufly cfd``: the air around a rotor, by a Navier-Stokes solver."""
