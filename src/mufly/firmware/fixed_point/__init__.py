"""The fixed-point law: its design, its compiled form and its flights."""
