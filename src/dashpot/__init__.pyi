"""The public names of dashpot with their types, for type checkers and editors."""

from dashpot.certify.box import certify_box as certify_box
from dashpot.certify.certificate import certify_arm as certify_arm
from dashpot.certify.certificate import certify_joint as certify_joint
from dashpot.certify.index import passivity_index as passivity_index
from dashpot.controller import Controller as Controller
from dashpot.controller import ControllerConfig as ControllerConfig
from dashpot.controller import JointGains as JointGains
from dashpot.controller import load_controller as load_controller
from dashpot.design.design import design_arm as design_arm
from dashpot.design.spec import Spec as Spec
from dashpot.drive import Drive as Drive
from dashpot.errors import DashpotError as DashpotError
from dashpot.errors import InputError as InputError
from dashpot.errors import InputWarning as InputWarning
from dashpot.errors import ModelError as ModelError
from dashpot.faults import Fault as Fault
from dashpot.identify import identify_joint as identify_joint
from dashpot.jointlaw import Law as Law
from dashpot.law import TorqueFeedbackLaw as TorqueFeedbackLaw
from dashpot.laws import LAWS as LAWS
from dashpot.network import VirtualNetwork as VirtualNetwork
from dashpot.payload import Payload as Payload
from dashpot.plant import Plant as Plant
from dashpot.plant import build as build
from dashpot.recording import Recording as Recording
from dashpot.robot import Robot as Robot
from dashpot.simulate import Event as Event
from dashpot.simulate import PayloadChange as PayloadChange
from dashpot.simulate import Scenario as Scenario
from dashpot.simulate import run as run
from dashpot.simulate import run_many as run_many
from dashpot.trajectory import Trajectory as Trajectory
from dashpot.trajectory import hold as hold
from dashpot.trajectory import multisine as multisine

__version__: str
