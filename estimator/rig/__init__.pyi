from .topic import open_topic as open_topic
