"""What firmware and other programs read: one target a file, each with a list of what it cannot carry.

    c           a C99 header and source: the whole model but for hysteresis; float, double or fixed point
    px4         thermal cubics and static terms as parameters of PX4
    ardupilot   the same for ArduPilot
    fusion      misalignment, sensitivity, offset for Fusion of x-io
    imucal      calibration of the Ferraris kind, as imucal keeps it; both ways
    ros         parameters of a ROS 2 node

Everything but c freezes the tables that its target has no place for; at which temperature is said in the result.
"""
