"""The three FMUs in OMSimulator 3 (OpenModelica). Build the FMUs first. Written by its documentation, not run here."""

import sys

try:
    from OMSimulator import SSP, CRef
except ImportError:
    sys.exit("OMSimulator is not installed: pip install OMSimulator, or see https://openmodelica.org")

FMUS = {"plant": "RobotPlant", "controller": "RobotController", "trajectory": "RobotTrajectory"}
CONNECTIONS = [
    ("plant", "theta_a", "controller"),
    ("plant", "omega_a", "controller"),
    ("trajectory", "theta_ref", "controller"),
    ("trajectory", "omega_ref", "controller"),
    ("controller", "tau_a", "plant"),
]

model = SSP()
model.newSolver({"name": "master", "method": "oms_ma", "fixedStepSize": 1e-3})
for instance, name in FMUS.items():
    model.addResource(f"fmus/fmi2/{name}.fmu", new_name=f"resources/{name}.fmu")
    model.addComponent(CRef("default", instance), f"resources/{name}.fmu")
    model.setSolver(CRef("default", instance), "master")
for source, variable, target in CONNECTIONS:
    for i in (1, 2, 3):
        element = f"{variable}[{i}]"
        model.addConnection(CRef("default", source, element), CRef("default", target, element))

run = model.instantiate()
run.setResultFile("robot.mat")
run.setStopTime(15.0)
run.initialize()
run.simulate()
run.terminate()
run.delete()
print("results: robot.mat")
