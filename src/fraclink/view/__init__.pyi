from fraclink.view._arm_page import write_arm_page as write_arm_page
from fraclink.view._notebook import draw as draw
from fraclink.view._plots import margins_against_payload as margins_against_payload
from fraclink.view._plots import phase_shares as phase_shares
from fraclink.view._report import write_report as write_report
from fraclink.view._runs import outcome_figure as outcome_figure

__all__: list[str]
