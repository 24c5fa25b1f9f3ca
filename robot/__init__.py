"""From simulation to a robot (paper IV-C): a room where reality interferes, ultrasonic sensors that
stop the robot, and what a robot of one's own needs."""
