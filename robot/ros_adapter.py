"""An adapter for ROS 2, never run: this project has neither a robot nor a machine with ROS."""

import time
from functools import partial

import numpy as np
import rclpy
from cv_bridge import CvBridge
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, Range

from robot.policy import OnnxPolicy
from robot.robot import Stamped, drive


class RosRobot(Node):
    """A Robot that reads and writes ROS 2 topics."""

    def __init__(self):
        super().__init__("navbot")
        self.bridge = CvBridge()
        self.last = {"image": None, "odometry": None}
        self.heard = [Stamped(np.nan, -np.inf)] * 24
        sensors = qos_profile_sensor_data  # best effort: lost messages are not sent again
        self.create_subscription(Image, "/camera/image_raw", self.on_image, sensors)
        self.create_subscription(Odometry, "/odom", self.on_odometry, sensors)
        for k in range(24):
            self.create_subscription(Range, f"/sonar_{k}", partial(self.on_range, k), sensors)
        self.wheels = self.create_publisher(Twist, "/cmd_vel", 1)

    def now(self):
        return time.monotonic()

    def sleep_until(self, moment):
        for _ in range(len(self.heard) + 2):  # whatever has arrived, even late
            rclpy.spin_once(self, timeout_sec=0)
        while self.now() < moment:
            rclpy.spin_once(self, timeout_sec=max(moment - self.now(), 0))

    def taken(self, stamp):
        """Returns the time of a measurement by the clock of `now`, from its message's stamp."""
        ago = self.get_clock().now().nanoseconds / 1e9 - (stamp.sec + stamp.nanosec / 1e9)
        return self.now() - ago

    def on_image(self, message):
        import cv2
        image = self.bridge.imgmsg_to_cv2(message, "rgb8")
        small = cv2.resize(image, (64, 48), interpolation=cv2.INTER_AREA)
        self.last["image"] = Stamped(small, self.taken(message.header.stamp))

    def on_odometry(self, message):
        place = message.pose.pose.position
        q = message.pose.pose.orientation
        theta = np.arctan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y ** 2 + q.z ** 2))
        self.last["odometry"] = Stamped((place.x, place.y, theta), self.taken(message.header.stamp))

    def on_range(self, k, message):
        self.heard[k] = Stamped(message.range, self.taken(message.header.stamp))

    def image(self):
        return self.last["image"]

    def odometry(self):
        return self.last["odometry"]

    def ranges(self):
        oldest = self.now() - 0.8  # [s] two periods; an older reading counts as missing
        values = [reading.value if reading.time >= oldest else np.nan for reading in self.heard]
        return Stamped(np.array(values), max(reading.time for reading in self.heard))

    def send(self, linear, angular):
        command = Twist()
        command.linear.x = linear
        command.angular.z = angular
        self.wheels.publish(command)


if __name__ == "__main__":
    # ROS's handler of Ctrl-C would close the connection before the wheels are stopped.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    robot = RosRobot()
    goal = (2.0, 0.5)  # [m] in odometry's coordinates
    print(drive(robot, OnnxPolicy("policy.onnx"), goal).outcome)
    rclpy.shutdown()
