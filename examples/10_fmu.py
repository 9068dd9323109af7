"""A controller as an FMU against a joint of one's own, run by FMPy as by Simulink or any other importer.

dashpot export fr3 fr3 --to fmu        # and pip install fmpy
python examples/10_fmu.py
"""

from fmpy import extract, read_model_description
from fmpy.fmi3 import FMU3Slave

FILE, PERIOD, STEPS, JOINT = "out/export/fr3.fmu", 0.001, 4, 3
INERTIA, FRICTION, STIFFNESS, LOAD = 0.6, 0.4, 1e4, 0.3  # rotor, transmission and link of joint 4, SI

description = read_model_description(FILE)
number = {variable.name: variable.valueReference for variable in description.modelVariables}
fmu = FMU3Slave(
    guid=description.instantiationToken,
    unzipDirectory=extract(FILE),
    modelIdentifier=description.coSimulation.modelIdentifier,
    instanceName="arm",
)
fmu.instantiate()
fmu.enterInitializationMode(startTime=0.0)
fmu.exitInitializationMode()
rotor = link = rotor_speed = link_speed = 0.0
for step in range(600 * STEPS):  # steps of a part of the period: a tick's torque acts within it
    sensed = STIFFNESS * (rotor - link)
    for name, value in (
        ("torque", sensed),
        ("position", rotor),
        ("velocity", rotor_speed),
        ("position_ref", 0.1),
    ):
        fmu.setFloat64([number[name]], [value if joint == JOINT else 0.0 for joint in range(7)])
    time, h = step * PERIOD / STEPS, PERIOD / STEPS
    fmu.doStep(currentCommunicationPoint=time, communicationStepSize=h)
    command = fmu.getFloat64([number["command"]], nValues=7)[JOINT]
    rotor_speed += h * (command - FRICTION * rotor_speed - sensed) / INERTIA
    link_speed += h * sensed / LOAD
    rotor, link = rotor + h * rotor_speed, link + h * link_speed
    if step % (100 * STEPS) == 0:
        print(f"{time:.1f} s: link at {link:7.4f} rad of 0.1, torque {command:7.3f} N m")
fmu.terminate()
fmu.freeInstance()
