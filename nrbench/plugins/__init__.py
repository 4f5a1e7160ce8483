"""Plugins: their registry, their parameters, and their forms (protocols)."""

from nrbench.plugins.form_checks import FORMS as FORMS
from nrbench.plugins.form_checks import PATCH_TERMS as PATCH_TERMS
from nrbench.plugins.form_checks import Form as Form
from nrbench.plugins.form_checks import describe_patches as describe_patches
from nrbench.plugins.registry import DoesNotLoad as DoesNotLoad
from nrbench.plugins.registry import NamedDetector as NamedDetector
from nrbench.plugins.registry import Plugin as Plugin
from nrbench.plugins.registry import add_file as add_file
from nrbench.plugins.registry import add_method as add_method
from nrbench.plugins.registry import build as build
from nrbench.plugins.registry import describe_lack as describe_lack
from nrbench.plugins.registry import fault as fault
from nrbench.plugins.registry import files as files
from nrbench.plugins.registry import find as find
from nrbench.plugins.registry import in_role as in_role
from nrbench.plugins.registry import inventory as inventory
from nrbench.plugins.registry import lookup as lookup
from nrbench.plugins.registry import name_of as name_of
from nrbench.plugins.registry import names as names
from nrbench.plugins.registry import parameters_of as parameters_of
from nrbench.plugins.registry import require_abilities as require_abilities
from nrbench.plugins.registry import summaries as summaries
from nrbench.plugins.registry import usual_parameters as usual_parameters
