"""The other side of the tests of `ros1`: rospy, run by the system's Python. Prints JSON lines.

`python3 rospy_peer.py ROLE NAME DEFINITIONS [RATE] [TOPIC ...]`; DEFINITIONS is JSON {type:
text}.
"""

import json
import sys
import time
from math import isnan

import rospy
from genpy.dynamic import generate_dynamic

PEOPLE, TRAJECTORIES = "people_msgs/People", "darko_perception_msgs/HumansTrajs"


def talk(classes, rate, topic="/people"):
    """People 1 and 2 walk at 1 m/s; the stamps are 0.1 s apart, whatever the rate."""
    publisher = rospy.Publisher(topic, classes[PEOPLE], queue_size=50)
    people, person = classes[PEOPLE], classes["people_msgs/Person"]
    start, n = time.time(), 0
    while not rospy.is_shutdown():
        message = people()
        message.header.stamp = rospy.Time.from_sec(start + n / 10)
        message.header.frame_id = "odom"
        for id in (1, 2):
            walker = person()
            walker.name = str(id)
            walker.position.x, walker.position.y = start % 1000 + n / 10, float(id)
            message.people.append(walker)
        publisher.publish(message)
        n += 1
        time.sleep(max(0.0, start + n / rate - time.time()))


def listen(classes, rate):
    """Says what comes on the three topics."""

    def say(topic):
        def hear(message):
            steps = []
            for step in message.trajs:
                humans = []
                for human in step.humans:
                    place = human.centroid.pose.position
                    humans.append([human.id, place.x, place.y])
                    assert not any(map(isnan, humans[-1]))
                steps.append(humans)
            row = {
                "topic": topic,
                "stamp": message.header.stamp.to_sec(),
                "steps": steps,
            }
            row["late"] = time.time() - row["stamp"]
            row["frame"] = message.header.frame_id
            # In one piece, as other threads print, too.
            print(json.dumps(row) + "\n", end="", flush=True)

        return hear

    for end in ("prediction", "prediction_pool_net", "gt"):
        topic = "/hri/human_poses_" + end
        rospy.Subscriber(topic, classes[TRAJECTORIES], say(topic), tcp_nodelay=True)
    print(json.dumps({"topic": "ready"}), flush=True)
    rospy.spin()


def hear(classes, rate, *topics):
    """Says once for each of `topics`, TOPIC=TYPE, that a message came."""
    said = set()
    for text in topics:
        topic, _, kind = text.partition("=")

        def say(message, topic=topic):
            if topic not in said:
                said.add(topic)
                print("heard " + topic + "\n", end="", flush=True)

        rospy.Subscriber(topic, classes[kind], say)
    rospy.spin()


def main():
    """Play the role."""
    role, name, path = sys.argv[1:4]
    with open(path) as file:
        definitions = json.load(file)
    classes = {}
    for kind, text in definitions.items():
        classes.update(generate_dynamic(kind, text))
    rospy.init_node(name, disable_signals=True)
    rate, *topics = sys.argv[4:] or ["10"]
    {"talk": talk, "listen": listen, "hear": hear}[role](classes, float(rate), *topics)


main()
