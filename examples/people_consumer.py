"""Say who is near: where people are on the map and where each will be in a second."""

from contextlib import suppress

import rclpy
from people_msgs.msg import People
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node


class PeopleConsumer(Node):
    """Prints a line for each person of the topic `people`."""

    def __init__(self) -> None:
        super().__init__('people_consumer')
        self.create_subscription(People, 'people', self._take, 10)

    def _take(self, msg: People) -> None:
        for person in msg.people:
            at, v = person.position, person.velocity
            now = f'({at.x:.2f}, {at.y:.2f}) m in {msg.header.frame_id}'
            soon = f'({at.x + v.x:.2f}, {at.y + v.y:.2f}) m'
            print(f'person {person.name} at {now}, in 1 s at {soon}', flush=True)


if __name__ == '__main__':
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(PeopleConsumer())
