"""The public names of dashpot with their types, for type checkers and editors."""

from dashpot.arm.drive import Drive as Drive
from dashpot.arm.payload import Payload as Payload
from dashpot.arm.plant import Plant as Plant
from dashpot.arm.plant import build as build
from dashpot.arm.robot import Robot as Robot
from dashpot.certify.box import certify_box as certify_box
from dashpot.certify.certificate import certify_arm as certify_arm
from dashpot.certify.certificate import certify_joint as certify_joint
from dashpot.certify.index import passivity_index as passivity_index
from dashpot.control.controller import Controller as Controller
from dashpot.control.controller import ControllerConfig as ControllerConfig
from dashpot.control.controller import JointGains as JointGains
from dashpot.control.controller import load_controller as load_controller
from dashpot.control.jointlaw import Law as Law
from dashpot.control.law import TorqueFeedbackLaw as TorqueFeedbackLaw
from dashpot.control.laws import LAWS as LAWS
from dashpot.control.network import VirtualNetwork as VirtualNetwork
from dashpot.design.design import design_arm as design_arm
from dashpot.design.spec import Spec as Spec
from dashpot.errors import DashpotError as DashpotError
from dashpot.errors import InputError as InputError
from dashpot.errors import InputWarning as InputWarning
from dashpot.errors import ModelError as ModelError
from dashpot.identify import identify_joint as identify_joint
from dashpot.simulation.faults import Fault as Fault
from dashpot.simulation.recording import Recording as Recording
from dashpot.simulation.simulate import Event as Event
from dashpot.simulation.simulate import PayloadChange as PayloadChange
from dashpot.simulation.simulate import Scenario as Scenario
from dashpot.simulation.simulate import run as run
from dashpot.simulation.simulate import run_many as run_many
from dashpot.simulation.trajectory import Trajectory as Trajectory
from dashpot.simulation.trajectory import hold as hold
from dashpot.simulation.trajectory import multisine as multisine

__version__: str
