"""Analysis of designs: comparison, margins, gusts, servos, rotor speed feedback, schedule over speed, pictures."""
