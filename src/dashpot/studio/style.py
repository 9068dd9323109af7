"""How viser's page is dressed: Okabe and Ito's blue, labels that are read from afar, a focus that is seen."""

from __future__ import annotations

STYLE = """<style>
:root, [data-mantine-color-scheme] {
  --mantine-primary-color-filled: #0072B2 !important;
  --mantine-primary-color-filled-hover: #005A8D !important;
  --mantine-color-dimmed: #3A3A3A !important;
}
.mantine-Button-root {--button-color: #fff !important; min-height: 0; height: 1.7rem !important}
.mantine-Button-root[style*="--button-bg"] {--button-color: #000 !important}
.mantine-Text-root, .mantine-Input-input {letter-spacing: 0 !important}
.mantine-Slider-root {margin: -7px 14px 9px 0}
.mantine-NumberInput-input, .mantine-TextInput-input
  {min-height: 1.4rem !important; height: 1.4rem !important}
.mantine-Checkbox-root {--checkbox-color: #0072B2 !important}
.mantine-Slider-thumb {background: #0072B2 !important}
.mantine-Slider-markLabel {color: #444; font-size: 10px !important}
.mantine-Slider-root:has(.mantine-Slider-markWrapper:nth-child(3)) + .mantine-NumberInput-root,
.mantine-Slider-root:has(.mantine-Slider-markWrapper:nth-child(3)) .mantine-Slider-label
  {display: none !important}
*:focus-visible {outline: 2px solid #0072B2 !important; outline-offset: 1px}
</style>"""
"""Log sliders, the ones with more than two marks, come without numbers: those would be logarithms."""
