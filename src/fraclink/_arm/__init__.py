"""What a laboratory has and wants: rig, link, beam, motor loop, controller, reference,
experiment.
"""
