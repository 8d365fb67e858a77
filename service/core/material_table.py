"""The named materials: typical values at room temperature and small strain, and where each of them comes from.

Every row is (name, Young's modulus in Pa, Poisson's ratio, lowest and highest Young's modulus, description, source).
Young's modulus was held against the publication, a table that quotes it, or the raw record of the test, unless the
source says otherwise: `_memory` marks what could not be looked up when it was entered, `_estimate` what nobody has
measured. Where a source gives no Poisson's ratio, it is that of the kind: 0.3 for foams, cloth and wood, 0.3 to 0.45
for plastics, and 0.49, the largest that the models know, for what is nearly incompressible.
"""

from __future__ import annotations

from typing import NamedTuple


class Source(NamedTuple):
    """Where a value comes from, and whether that was looked up."""

    text: str
    checked: bool = True


class Row(NamedTuple):
    """A material as the table writes it down."""

    name: str
    young_modulus_pa: float
    poisson_ratio: float
    low_pa: float
    high_pa: float
    description: str
    source: Source


def _memory(text: str) -> Source:
    return Source(f"{text} (cited from memory, not looked up)", checked=False)


def _estimate(text: str) -> Source:
    return Source(f"estimate: {text}", checked=False)


_CUED = _memory("Cambridge University Engineering Department, Materials Data Book (2003)")
_ASHBY = _memory("Materials Data Book (Cambridge, 2003); Gibson & Ashby, Cellular Solids (1997)")
_CALLISTER = Source("Callister, Materials Science and Engineering, table B.2")
_DOWLING = Source("Dowling, Mechanical Behavior of Materials, tables 4.3 and 5.2")
_BOTH = Source("Callister, table B.2; Poisson's ratio: Dowling, table 5.2")
_GERE = Source("Gere, Mechanics of Materials, 5th ed. (2001)")
_LAI = Source("Dowling, table 5.2; range: Lai, Rubin & Krempl, Introduction to Continuum Mechanics, table 5.2")
_WOODS = Source("Callister, table B.2; lower end: pine, Young et al. (1998)")
_EPS = Source("ASTM D6817, compressive resistance at 1 %, grades EPS12 to EPS39")
_DAWOOD = Source(
    "Dawood et al., Tissue Phantom Materials Database (2026), compression; "
    "range: tension, Marechal et al., Soft Robotics 8 (2021) 284, to the data sheet's 100 % modulus"
)
_MARECHAL = Source(
    "neo-Hookean fit up to 50 % of the tensile record in Marechal et al., Soft Robotics 8 (2021) 284; "
    "range: up to 20 %, and Gent (1958) for its hardness"
)
_SMOOTH_ON = Source(
    "100 % modulus of the maker's data sheet (Smooth-On, from memory), E = 3 σ / (λ - λ⁻²) at λ = 2; "
    "lower end: tensile record in Marechal et al., Soft Robotics 8 (2021) 284"
)
_GELATIN = Source("E = 3 μ, Nguyen et al., Ultrasound Med. Biol. 40 (2014) 168-176")
_CHEESE = Source("compression, J. Nutr. Food Sci. 2 (2012) 136, table 4")
_NOWAK = Source("compression and ultrasound at 5 and 20 °C, Nowak & Markowski, J. Food Eng. 147 (2015) 49-55")
_GRILLED = Source("three grilling temperatures, J. Food Qual. (2022) 9176628, table 4")
_ARDA = Source("shear-wave elastography of 127 volunteers, Arda et al., Am. J. Roentgenol. 197 (2011) 532-536")
_BUDDAY = Source("indentation of bovine brain, Budday et al., J. Mech. Behav. Biomed. Mater. 46 (2015) 318-330")
_TISSUES = Source("ranges collected in Mater. Today Bio 31 (2025) 101617, table 1")
_ORGANS = "as collected by Dawood et al., Tissue Phantom Materials Database (2026)"
_ESTIMATED_TOY = _estimate(
    "nobody publishes toys; the softest of 285 everyday objects in Burgess et al., arXiv:2406.15304, have 5 kPa"
)

TABLE: dict[str, tuple[Row, ...]] = {
    "foam": (
        Row("mattress_foam", 1.8e4, 0.3, 5.5e3, 4e4, "upholstery and mattress foam, deeply pressed",
            Source("secant at 25 %: indentation force (ILD) of 25 to 40 lb on 50 in²; range 10 to 70 lb")),
        Row("foam_very_soft", 6e5, 0.3, 3e5, 1e6, "flexible polymer foam, very low density, small strain", _ASHBY),
        Row("foam_soft", 2e6, 0.3, 1e6, 3e6, "flexible polymer foam, low density", _ASHBY),
        Row("foam_firm", 8e6, 0.3, 4e6, 1.2e7, "flexible polymer foam, medium density", _ASHBY),
        Row("foam_rigid", 5e7, 0.3, 2.3e7, 8e7, "rigid polymer foam, low density", _ASHBY),
        Row("polyethylene_foam", 1.6e5, 0.3, 1.6e5, 2.9e5, "closed-cell PE foam, 33 kg/m³: packaging, swim noodles",
            Source("secant at 25 to 60 % from the data sheet of Plastazote LD33 (Zotefoams)")),
        Row("eps_15", 2.5e6, 0.1, 1.5e6, 4e6, "expanded polystyrene, 14 kg/m³: packaging", _EPS),
        Row("eps_30", 7.5e6, 0.1, 5e6, 1.03e7, "expanded polystyrene, 29 kg/m³: firm packaging, helmets", _EPS),
        Row("tpu_foam", 3.1e5, 0.3, 3.1e5, 8e5, "microcellular TPU foam, 0.12 g/cm³: soles",
            Source("compressive stress at 10 %, data sheet of Shincell's TPU foam, densities 0.12 to 0.19 g/cm³")),
        Row("running_shoe_foam", 2.8e5, 0.0, 2.5e5, 3.3e5, "ultralight midsole foam of racing shoes",
            Source("McCulloch, Delp & Kuhl, arXiv:2602.12694 (2026), compression")),
        Row("sponge_rubber", 9e4, 0.3, 5.5e4, 1.4e5, "open-cell natural sponge rubber",
            Source("secant at 25 % of ASTM D1056 grade 2A1: 2 to 5 psi")),
        Row("cork", 3e7, 0.05, 1.3e7, 5e7, "cork", _ASHBY),
    ),
    "silicone": (
        Row("silicone", 1.14e6, 0.49, 2.8e5, 5.5e6, "silicone rubber of medium hardness, Shore A 30",
            Source("Gent, Rubber Chem. Technol. 31 (1958) 896, at Shore A 30; range: Shore A 5 to 70")),
        Row("ecoflex_00_10", 5.6e4, 0.49, 1.9e4, 9.4e4, "very soft silicone", _DAWOOD),
        Row("ecoflex_00_30", 1.03e5, 0.49, 4.1e4, 1.2e5, "soft silicone of soft robots", _DAWOOD),
        Row("ecoflex_00_50", 1.59e5, 0.49, 5.5e4, 1.6e5, "soft silicone", _DAWOOD),
        Row("dragon_skin_fx_pro", 8.8e4, 0.49, 7.8e4, 2.0e5, "soft silicone of masks and skins, Shore A 2", _MARECHAL),
        Row("dragon_skin_10", 2.6e5, 0.49, 1.2e5, 4.1e5, "silicone of soft grippers", _SMOOTH_ON),
        Row("dragon_skin_20", 3.9e5, 0.49, 3.2e5, 7.3e5, "silicone of soft grippers, Shore A 20", _MARECHAL),
        Row("dragon_skin_30", 1.0e6, 0.49, 5.1e5, 1.3e6, "firm silicone of soft grippers", _SMOOTH_ON),
        Row("mold_star_16", 2.6e5, 0.49, 2.4e5, 6.0e5, "mould-making silicone, Shore A 16", _MARECHAL),
        Row("mold_star_20t", 3.4e5, 0.49, 3.2e5, 7.3e5, "mould-making silicone, Shore A 20", _MARECHAL),
        Row("platsil_gel_10", 1.8e5, 0.49, 1.5e5, 4.1e5, "silicone of prosthetics and animatronics", _MARECHAL),
        Row("sortaclear_40", 8.6e5, 0.49, 8.2e5, 1.7e6, "clear, food-safe silicone, Shore A 40", _MARECHAL),
        Row("rtv615", 1.05e6, 0.49, 9.8e5, 2.0e6, "clear potting silicone, Shore A 44", _MARECHAL),
        Row("pdms", 1.75e6, 0.49, 1.32e6, 2.97e6, "Sylgard 184 silicone, 10:1",
            Source("Johnston et al., J. Micromech. Microeng. 24 (2014) 035017, cured at 25 to 200 °C")),
        Row("pdms_20_1", 1.0e6, 0.49, 8e5, 1.2e6, "Sylgard 184 silicone, 20:1",
            Source("E = 20 MPa / mixing ratio, Wang et al., J. Appl. Polym. Sci. 131 (2014) 41050; range ± 20 %")),
        Row("pdms_30_1", 6.7e5, 0.49, 5.3e5, 8e5, "Sylgard 184 silicone, 30:1",
            Source("E = 20 MPa / mixing ratio, Wang et al., J. Appl. Polym. Sci. 131 (2014) 41050; range ± 20 %")),
    ),
    "rubber": (
        Row("natural_rubber", 2.0e6, 0.49, 7e5, 4e6, "natural rubber, unfilled", _GERE),
        Row("natural_rubber_vulcanised", 2.6e6, 0.49, 1.5e6, 4e6, "vulcanised natural rubber",
            Source("100 % modulus 1.5 MPa (MatWeb), E = 3 σ / (λ - λ⁻²) at λ = 2; range: Gere (2001)")),
        Row("neoprene", 1.4e6, 0.49, 7e5, 2e6, "polychloroprene rubber", _CUED),
        Row("butyl_rubber", 1.5e6, 0.49, 1e6, 2e6, "butyl rubber", _CUED),
        Row("eva", 2.5e7, 0.48, 1e7, 4e7, "ethylene vinyl acetate, solid", _CUED),
    ),
    "gel": (
        Row("gelatin_3_percent", 6.0e3, 0.49, 5.3e3, 6.8e3, "gelatin gel, 3 % by mass: a soft jelly", _GELATIN),
        Row("gelatin_4_percent", 9.3e3, 0.49, 8.3e3, 1.03e4, "gelatin gel, 4 % by mass: a jelly", _GELATIN),
        Row("gelatin_5_percent", 1.25e4, 0.49, 1.0e4, 1.5e4, "gelatin gel, 5 % by mass: a jelly", _GELATIN),
        Row("gelatin_6_percent", 2.4e4, 0.49, 2.1e4, 2.7e4, "gelatin gel, 6 % by mass: a firm jelly", _GELATIN),
        Row("gelatin_7_percent", 3.07e4, 0.49, 2.5e4, 3.6e4, "gelatin gel, 7 % by mass: a firm jelly", _GELATIN),
        Row("polyacrylamide_gel", 3.49e4, 0.49, 3.2e4, 3.8e4, "polyacrylamide hydrogel, 10 % / 0.3 % bis",
            _memory("Tse & Engler, Curr. Protoc. Cell Biol. 47 (2010) 10.16")),
        Row("hydrogel", 3e4, 0.49, 1e3, 2e5, "hydrogel of medium stiffness",
            Source("range: Antipova et al., Polymers 17 (2025) 737; the typical value is an estimate inside it")),
    ),
    "food": (
        Row("bread_crumb", 8e3, 0.3, 7e3, 5e4, "crumb of white bread",
            Source("tension, and dynamic test at 0.02 %, Scanlon & Zghal, Food Res. Int. 34 (2001) 841-864")),
        Row("marshmallow", 3e4, 0.3, 2e4, 4.5e4, "marshmallow",
            Source("about 30 kPa, in a school laboratory on Young's modulus; range ± 50 % is an estimate")),
        Row("cheddar_mild", 1.13e5, 0.49, 1.03e5, 1.23e5, "mild Cheddar cheese", _CHEESE),
        Row("cheddar_medium", 2.3e5, 0.49, 1.9e5, 2.7e5, "medium Cheddar cheese", _CHEESE),
        Row("mozzarella", 2.2e5, 0.49, 7.7e4, 2.6e5, "mozzarella cheese, low moisture", _CHEESE),
        Row("ham", 1.5e5, 0.49, 1.47e5, 1.93e5, "canned ham", _NOWAK),
        Row("sausage", 1.0e5, 0.49, 8.6e4, 1.48e5, "sausage of coarse pork", _NOWAK),
        Row("pork_grilled", 7.5e4, 0.45, 2.8e4, 1.5e5, "grilled pork", _GRILLED),
        Row("chicken_grilled", 5.0e4, 0.4, 3.1e4, 7.4e4, "grilled chicken breast", _GRILLED),
        Row("pineapple", 7.8e5, 0.4, 1.35e5, 7.8e5, "pineapple flesh",
            Source("Khodabakhshian & Hassani: Hertz contact to compressed cylinders; Poisson's ratio is an estimate")),
        Row("apple", 3e6, 0.3, 5e5, 7e6, "apple flesh", _memory("Khan & Vincent, J. Texture Stud. 24 (1993) 423-435")),
        Row("potato", 3.6e6, 0.49, 2e6, 5e6, "raw potato", _memory("Finney & Hall, Trans. ASAE 10 (1967) 4-8")),
        Row("tofu_firm", 3e4, 0.45, 1e4, 6e4, "firm tofu", _estimate("between a firm jelly and a soft cheese")),
        Row("egg_white_boiled", 3e4, 0.49, 1e4, 6e4, "white of a hard-boiled egg", _estimate("like a firm jelly")),
        Row("banana", 1e5, 0.45, 3e4, 5e5, "flesh of a ripe banana", _estimate("softens tenfold while it ripens")),
        Row("dough", 1e4, 0.49, 2e3, 5e4, "bread dough; it flows, so only for short pushes", _estimate("a soft gel")),
    ),
    "tissue": (
        Row("brain_grey_matter", 1.39e3, 0.49, 1.1e3, 1.7e3, "grey matter of the brain", _BUDDAY),
        Row("brain_white_matter", 1.9e3, 0.49, 1.3e3, 2.5e3, "white matter of the brain", _BUDDAY),
        Row("stomach_wall", 1.91e3, 0.49, 1.08e3, 3.01e3, "wall of the stomach",
            Source(f"Lim et al., Surg. Endosc. 23 (2009), {_ORGANS}")),
        Row("spleen", 2.9e3, 0.49, 1.1e3, 4.7e3, "spleen", _ARDA),
        Row("pancreas", 4.8e3, 0.49, 1.8e3, 7.8e3, "pancreas", _ARDA),
        Row("kidney", 5.0e3, 0.49, 2.1e3, 7.9e3, "cortex of the kidney", _ARDA),
        Row("liver", 6.4e3, 0.49, 4.1e3, 8.0e3, "healthy liver",
            Source("E = 3 μ, elastography (MR) of 102 volunteers, Obrzut et al., Pol. Arch. Intern. Med.")),
        Row("salivary_gland", 1.04e4, 0.49, 6.9e3, 1.39e4, "parotid gland", _ARDA),
        Row("thyroid", 1.1e4, 0.49, 7.9e3, 1.41e4, "thyroid gland", _ARDA),
        Row("muscle", 1.11e4, 0.49, 7.0e3, 1.52e4, "relaxed skeletal muscle across the grain, raw meat", _ARDA),
        Row("prostate", 1.53e4, 0.49, 9.8e3, 2.14e4, "healthy prostate",
            Source(f"Ahn et al., J. Endourol. 25 (2011), indentation, {_ORGANS}")),
        Row("fat", 1.8e4, 0.49, 1.1e4, 2.8e4, "fat under the skin",
            Source(f"Krouskop et al., Ultrason. Imaging 20 (1998), compression, {_ORGANS}")),
        Row("skin", 3.44e5, 0.49, 1.95e5, 4.8e5, "human skin, sucked at",
            Source("23 volunteers, In vivo measurement of breast skin elasticity and thickness, suction cup")),
        Row("cartilage", 5e6, 0.4, 7e5, 1.53e7, "articular cartilage", _TISSUES),
        Row("rib_cartilage", 1.3e7, 0.4, 1.1e7, 3.3e7, "costal cartilage",
            Source("12 donors, Anisotropic and age-dependent elastic … human costal cartilage, Sci. Rep. (2021)")),
        Row("tendon", 1.2e9, 0.4, 1.43e8, 2.31e9, "tendon, pulled along its fibres", _TISSUES),
        Row("bone_cancellous", 5e8, 0.3, 5e7, 5e9, "spongy bone", _TISSUES),
        Row("bone_cortical", 1.7e10, 0.3, 3e9, 3e10, "compact bone", _TISSUES),
    ),
    "plastic": (
        Row("polyethylene_low_density", 2.3e8, 0.42, 1.72e8, 2.82e8, "LDPE: bags, squeeze bottles", _BOTH),
        Row("ptfe", 4.7e8, 0.46, 4.0e8, 5.5e8, "PTFE, Teflon", _CALLISTER),
        Row("uhmwpe", 6.9e8, 0.42, 6.2e8, 7.6e8, "ultra-high-molecular-weight polyethylene; range ± 10 %", _BOTH),
        Row("polyethylene", 1.08e9, 0.42, 7e8, 1.4e9, "polyethylene, HDPE: bottles, lids, toys", _BOTH),
        Row("polypropylene", 1.3e9, 0.41, 1.14e9, 1.55e9, "polypropylene: food boxes, cups", _CALLISTER),
        Row("abs", 2.4e9, 0.35, 2.1e9, 2.8e9, "ABS: bricks, housings, 3D prints", _DOWLING),
        Row("polycarbonate", 2.4e9, 0.38, 2.2e9, 2.6e9, "polycarbonate: visors, phone cases; range ± 10 %", _DOWLING),
        Row("acrylic", 2.7e9, 0.35, 2.3e9, 3.2e9, "PMMA, acrylic glass", _DOWLING),
        Row("nylon", 2.7e9, 0.41, 2.6e9, 3.2e9, "nylon, dry", _DOWLING),
        Row("polystyrene", 2.8e9, 0.35, 2.28e9, 3.28e9, "polystyrene, solid: cutlery, cups", _CALLISTER),
        Row("pvc", 3.0e9, 0.38, 2.41e9, 4.14e9, "rigid PVC: pipes", _CALLISTER),
        Row("pet", 3.0e9, 0.39, 2.76e9, 4.14e9, "PET: drinks bottles, solid", _CALLISTER),
        Row("acetal", 3.1e9, 0.37, 2.8e9, 3.4e9, "POM, Delrin: gears; range ± 10 %",
            Source("Ensinger Delrin 150, 3.1 GPa, as quoted in PMC11019708, table 2")),
        Row("pla", 3.5e9, 0.36, 2.3e9, 4.1e9, "PLA: 3D prints, solid", _memory("makers' data sheets")),
        Row("epoxy", 3.5e9, 0.33, 2.4e9, 3.5e9, "epoxy, cast", _DOWLING),
    ),
    "wood": (
        Row("balsa", 3.4e9, 0.3, 2.5e9, 4.3e9, "balsa wood along the grain; range ± 25 %",
            Source("USDA Wood Handbook")),
        Row("cedar", 7.6e9, 0.3, 6.5e9, 8.7e9, "cedar wood along the grain; range ± 15 %",
            Source("Young et al., The Science and Technology of Civil Engineering Materials (1998)")),
        Row("pine", 1.0e10, 0.3, 8.3e9, 1.4e10, "pine wood along the grain",
            Source("Young et al. (1998); southern pine: Gere, Mechanics of Materials (2001)")),
        Row("douglas_fir", 1.2e10, 0.29, 1.08e10, 1.36e10, "Douglas fir along the grain", _CALLISTER),
        Row("oak", 1.25e10, 0.3, 1.1e10, 1.41e10, "red oak along the grain", _CALLISTER),
        Row("wood_along_grain", 1.1e10, 0.3, 8.3e9, 1.41e10, "wood, loaded along the grain", _WOODS),
        Row("wood_across_grain", 6.2e8, 0.3, 5.4e8, 7.1e8, "wood, loaded across the grain", _CALLISTER),
    ),
    "textile": (
        Row("plush_toy", 1e4, 0.3, 5e3, 3e4, "cloth toy stuffed with polyester fibre: teddy bear", _ESTIMATED_TOY),
        Row("cushion", 8e3, 0.3, 3e3, 2e4, "cushion or pillow stuffed with polyester fibre", _ESTIMATED_TOY),
        Row("beanbag", 5e4, 0.3, 1e4, 2e5, "cloth bag filled with beads; it flows and does not come back",
            _estimate("stiffens with how full it is")),
        Row("towel_folded", 4e4, 0.2, 1e4, 2e5, "towel or clothes, folded", _estimate("a stack of loose cloth")),
        Row("felt", 1e6, 0.2, 2e5, 5e6, "pressed wool felt", _estimate("between a foam and leather")),
        Row("leather", 3e8, 0.4, 1e8, 5e8, "leather", _CUED),
        Row("cardboard", 1e9, 0.3, 3e8, 3e9, "solid board and paper, in the plane", _memory("paper-making handbooks")),
    ),
    "metal": (
        Row("lead", 1.61e10, 0.44, 1.45e10, 1.77e10, "lead; range ± 10 %", _DOWLING),
        Row("magnesium", 4.47e10, 0.291, 4.1e10, 4.5e10, "magnesium alloys", Source("Dowling, table 5.2; Gere (2001)")),
        Row("aluminium", 7.0e10, 0.345, 6.82e10, 7.9e10, "aluminium alloys: cans", _LAI),
        Row("brass", 1.01e11, 0.35, 9.6e10, 1.1e11, "brass", _LAI),
        Row("cast_iron", 1.1e11, 0.25, 9e10, 1.45e11, "grey cast iron", _LAI),
        Row("titanium", 1.2e11, 0.361, 1.0e11, 1.2e11, "titanium", Source("Dowling, table 5.2; Gere (2001)")),
        Row("copper", 1.3e11, 0.343, 1.17e11, 1.3e11, "copper", _LAI),
        Row("stainless_steel", 1.93e11, 0.3, 1.93e11, 2.15e11, "stainless steel: cutlery, pots", _LAI),
        Row("steel", 2.1e11, 0.29, 1.9e11, 2.12e11, "low-carbon steel", Source("Dowling, table 5.2; Gere (2001)")),
    ),
    "mineral": (
        Row("concrete", 2.4e10, 0.15, 1.7e10, 3.1e10, "concrete", _GERE),
        Row("stone", 5.0e10, 0.21, 2e10, 1e11, "granite, limestone, marble", Source("Dowling, table 5.2; Gere (2001)")),
        Row("glass", 7.0e10, 0.2, 4.8e10, 8.3e10, "soda-lime glass: jars, bottles",
            Source("Dowling, table 5.2; Gere (2001)")),
        Row("ceramic", 4.0e11, 0.22, 3.6e11, 4.4e11, "alumina ceramic; range ± 10 %", _DOWLING),
    ),
}  # fmt: skip
