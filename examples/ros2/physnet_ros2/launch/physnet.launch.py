"""Start the node on a camera: `ros2 launch physnet_ros2 physnet.launch.py camera:=/camera/camera`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    camera = LaunchConfiguration("camera")
    parameters = PathJoinSubstitution([FindPackageShare("physnet_ros2"), "config", "physnet.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("camera", default_value="/camera/camera", description="namespace of the camera"),
            DeclareLaunchArgument("service", default_value="grpc://127.0.0.1:8001", description="PhysNet service"),
            DeclareLaunchArgument("parameters", default_value=parameters, description="file of parameters"),
            Node(
                package="physnet_ros2",
                executable="physnet_node",
                name="physnet",
                output="screen",
                parameters=[LaunchConfiguration("parameters"), {"service": LaunchConfiguration("service")}],
                remappings=[
                    ("depth", [camera, "/depth/image_rect_raw"]),
                    ("camera_info", [camera, "/depth/camera_info"]),
                ],
            ),
        ]
    )
