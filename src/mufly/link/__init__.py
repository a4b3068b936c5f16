"""Who speaks with whom? MAVLink, both ends of it, as protocol machines with sockets at the edge."""
