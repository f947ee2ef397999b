"""The parts of an experiment: rig, link, beam, motor loop, controller, reference and
recorded log.
"""
