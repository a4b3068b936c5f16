"""Structure of a blade: materials, cross-sections, the blade as a beam, and the rotor with elastic blades."""
