"""A middleware within the process: what the nodes do is tested without ROS."""

import threading
import time

from gctd3.bridge.middleware import Middleware


class Hub:
    """Hold the nodes that exchange messages, and every message that was published."""

    def __init__(self):
        self.nodes, self.services, self.published = [], {}, []

    def of(self, *names):
        """Return the messages that were published on topics."""
        return [message for topic, message in list(self.published) if topic.name in names]


class Loopback(Middleware):
    """Join a hub as a node."""

    where = "within the process"

    def __init__(self, hub):
        super().__init__()
        self.hub, self.out, self.into = hub, set(), set()
        hub.nodes.append(self)

    def advertise(self, topics):
        self.out |= set(topics)

    def subscribe(self, topics):
        self.into |= set(topics)

    def serve(self, name, function):
        self.hub.services[name] = function

    def publish(self, topic, message):
        assert topic in self.out
        self.hub.published.append((topic, message))
        for node in self.hub.nodes:
            if node is not self and topic in node.into:
                node._inbox.put((topic, message))

    def lonely(self, topics):
        others = [node for node in self.hub.nodes if node is not self]
        return [t.name for t in topics if not any(t in (node.into if t in self.out else node.out) for node in others)]

    def now(self):
        return time.time_ns()

    def close(self):
        self.hub.nodes.remove(self)


class Task(threading.Thread):
    """Run a function beside the test, and keep its result or its error."""

    def __init__(self, function):
        super().__init__(daemon=True)
        self.function, self.result, self.error = function, None, None
        self.start()

    def run(self):
        try:
            self.result = self.function()
        except Exception as error:
            self.error = error

    def done(self, within=60.0):
        """Wait for the end, and return the result, or raise the error."""
        self.join(within)
        assert not self.is_alive(), "it goes on"
        if self.error is not None:
            raise self.error
        return self.result
