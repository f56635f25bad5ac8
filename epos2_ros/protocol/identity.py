"""Who made a drive and what it is: objects 0x1008, 0x100A and 0x1018 in words (CiA 301, 7.5.2).

On an EPOS2 the upper half of the product code is the hardware version and that of the revision
number the software version (maxon's EDS of 2007 to 2013). What other makers mean by the two is
theirs: there the strings 0x1008 and 0x100A speak.
"""

from __future__ import annotations

from dataclasses import dataclass

MAXON, COPLEY, NANOTEC = 0x0000_00FB, 0x0000_00AB, 0x0000_026C
MAKERS = {MAXON: "maxon", COPLEY: "Copley", NANOTEC: "Nanotec"}
EPOS2_HARDWARE = {0x6020: "EPOS2 24/2", 0x6322: "EPOS2 50/5", 0x6420: "EPOS2 70/10"}


@dataclass(frozen=True)
class Identity:
    """What a drive says it is."""

    vendor_id: int  # 0x1018-01
    product_code: int  # -02
    revision: int  # -03
    serial_number: int  # -04
    name: str = ""  # 0x1008
    software: str = ""  # 0x100A; the EPOS2 has none

    @property
    def maker(self) -> str:
        return MAKERS.get(self.vendor_id, f"vendor 0x{self.vendor_id:08X}")

    @property
    def product(self) -> str:
        """By the maker's name for it, as far as it can be told."""
        hardware = self.product_code >> 16
        if self.vendor_id == MAXON:
            name = self.name or "product"
            return EPOS2_HARDWARE.get(hardware, f"{name} (hardware {hardware:04X}h)")
        return self.name or f"product 0x{self.product_code:08X}"

    def same_model(self, other: Identity) -> bool:
        """Whether both are of one kind, whatever their firmware and serial numbers."""
        mine, its = ((who.vendor_id, who.product_code, who.name) for who in (self, other))
        return mine == its

    @property
    def firmware(self) -> str:
        if self.vendor_id == MAXON:
            return f"{self.revision >> 16:04X}h"
        return self.software or f"revision 0x{self.revision:08X}"

    def __str__(self) -> str:
        return (
            f"{self.maker} {self.product}, firmware {self.firmware}, "
            f"serial number {self.serial_number}"
        )
