# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's entry into the extension: what it calls to switch VIR on and off. All else is in vir_addon."""

from .vir_addon.blender import register, unregister

__all__ = ["register", "unregister"]
