"""A node that asks a PhysNet service about every depth frame, and publishes what a push would make of the object.

Subscribed: `depth` (sensor_msgs/Image), `camera_info`, `~/contact` (geometry_msgs/PointStamped, in the camera's frame),
`~/force` (geometry_msgs/Vector3Stamped, in the camera's frame). Published: `~/deformed` (PointCloud2 with
displacements), `~/surface` (Marker), `~/max_displacement` (Float64, metres). The frame's own header goes with each
answer. Frames go through a stream in which the newest wins: the node never falls behind the camera.
"""

from __future__ import annotations

import threading
from typing import Any

import rclpy
from geometry_msgs.msg import Point, PointStamped, Vector3Stamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Float64
from tf2_ros import Buffer, TransformException, TransformListener
from visualization_msgs.msg import Marker

from physnet_ros2.conversions import cloud_of, marker_of, material_of
from service.client import Camera, PhysNetClient, PhysNetError, Push
from service.client.ros import camera_of, depth_of, rotation_of, stamp_ns

CLASSES = {
    "PointCloud2": PointCloud2, "PointField": PointField, "Marker": Marker, "Point": Point, "ColorRGBA": ColorRGBA,
}  # fmt: skip
REMEMBERED = 64
"""Headers kept for answers that are due."""


class PhysNetNode(Node):
    """See the module."""

    def __init__(self) -> None:
        super().__init__("physnet")
        service = self.declare_parameter("service", "grpc://127.0.0.1:8001").value
        self._material = material_of(self.declare_parameter("material", "silicone").value)
        self._press_px = list(self.declare_parameter("press_px", [320.0, 240.0]).value)
        self._force_n = list(self.declare_parameter("force_n", [0.0, 0.0, 5.0]).value)
        self._up_frame = self.declare_parameter("up_frame", "").value
        self._camera: Camera | None = None
        self._contact_m: list[float] | None = None
        self._headers: dict[int, Any] = {}
        self._transforms = Buffer()
        self._listener = TransformListener(self._transforms, self)
        self._cloud = self.create_publisher(PointCloud2, "~/deformed", 1)
        self._surface = self.create_publisher(Marker, "~/surface", 1)
        self._largest = self.create_publisher(Float64, "~/max_displacement", 1)
        self._client = PhysNetClient(service)
        self._stream = self._client.stream(backlog=1)
        self._reader = threading.Thread(target=self._publish_answers, daemon=True)
        self._reader.start()
        self.create_subscription(CameraInfo, "camera_info", self._on_info, qos_profile_sensor_data)
        self.create_subscription(Image, "depth", self._on_depth, qos_profile_sensor_data)
        self.create_subscription(PointStamped, "~/contact", self._on_contact, 1)
        self.create_subscription(Vector3Stamped, "~/force", self._on_force, 1)
        self.get_logger().info(f"asking {service}")

    def _on_info(self, message: CameraInfo) -> None:
        try:
            self._camera = camera_of(message)
        except ValueError as error:
            self.get_logger().error(str(error), throttle_duration_sec=5.0)

    def _on_contact(self, message: PointStamped) -> None:
        self._contact_m = [message.point.x, message.point.y, message.point.z]

    def _on_force(self, message: Vector3Stamped) -> None:
        self._force_n = [message.vector.x, message.vector.y, message.vector.z]

    def _on_depth(self, message: Image) -> None:
        if self._camera is None:
            return
        contact = {"contact_px": self._press_px} if self._contact_m is None else {"contact_m": self._contact_m}
        number = stamp_ns(message.header)
        try:
            self._headers[number] = message.header
            self._stream.send(
                depth_of(message), self._camera, Push(self._force_n, **contact), self._material,
                frame_id=number, up=self._up(message.header.frame_id),
            )  # fmt: skip
        except (ValueError, PhysNetError) as error:
            self._headers.pop(number, None)
            self.get_logger().error(str(error), throttle_duration_sec=5.0)
        for old in sorted(self._headers)[:-REMEMBERED]:
            self._headers.pop(old, None)

    def _up(self, camera_frame: str) -> Any:
        """Against gravity in the camera's frame; None, and the support plane is searched, while nobody knows."""
        if not self._up_frame:
            return None
        try:
            found = self._transforms.lookup_transform(camera_frame, self._up_frame, rclpy.time.Time())
        except TransformException as error:
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return None
        return rotation_of(found.transform.rotation)[:, 2]

    def _publish_answers(self) -> None:
        try:
            for answer in self._stream:
                header = self._headers.pop(answer.frame_id, None)
                if answer.error is not None:
                    text = f"{answer.error.code}: {answer.error.message}"
                    self.get_logger().warning(text, throttle_duration_sec=1.0)
                elif header is not None and answer.result is not None:
                    self._cloud.publish(cloud_of(answer.result, header, CLASSES))
                    self._surface.publish(marker_of(answer.result, header, CLASSES))
                    self._largest.publish(Float64(data=answer.result.max_displacement_m))
        except PhysNetError as error:
            self.get_logger().fatal(f"no more answers: {error}")

    def destroy_node(self) -> None:
        """Hang up before the node goes."""
        self._stream.close(drain=False)
        self._client.close()
        super().destroy_node()


def main() -> None:
    """Run until interrupted."""
    rclpy.init()
    node = PhysNetNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
