"""The interface in other languages than English: what Blender looks its texts up in. Texts of plans and errors are English everywhere.

Texts that Blender has itself (Presets, Light, Memory) are translated by it.
"""

from __future__ import annotations

import bpy

_ANY, _OPERATOR = "*", "Operator"
_GERMAN = {
    # names and labels
    "Render with F12": "Mit F12 rendern",
    "Soft Shadows": "Weiche Schatten",
    "Omni Shadows": "Rundum-Schatten",
    "Reflections": "Spiegelungen",
    "Device": "Gerät",
    "Quality": "Qualität",
    "Views": "Ansichten",
    "Map Resolution": "Auflösung der Karten",
    "Method": "Verfahren",
    "Look-ups": "Nachschlagen",
    "Adaptive": "Angepasst",
    "Full": "Vollständig",
    "Hybrid": "Gemischt",
    "Points": "Punkte",
    "Kept": "Aufgehoben",
    "Made Anew": "Jedes Mal neu",
    "Made by": "Erzeugt von",
    "Kernels": "Rechenkerne",
    "Rasterizer": "Rasterisierer",
    "Cull at Random": "Zufällig auslassen",
    "Below": "Unterhalb von",
    "Leave Out Hidden": "Verdecktes auslassen",
    "Watertight": "Wasserdicht",
    "Points per Triangle": "Punkte je Dreieck",
    "Back Faces": "Rückseiten",
    "Views per Thread": "Ansichten je Thread",
    "Search Samples": "Stichproben der Suche",
    "Filter Samples": "Stichproben des Filters",
    "Bounces": "Spiegelungen in Spiegeln",
    "Flat Mirrors Exactly": "Ebene Spiegel genau",
    "Look-up": "Nachschlagen",
    "March": "Schrittweise",
    "Direction": "Richtung",
    "Cubes": "Würfel",
    "Passes per Reflector": "Pässe je Spiegel",
    "Multiview (mvr)": "Viele Ansichten (mvr)",
    "Points (ivir)": "Punkte (ivir)",
    "Eye-based Points (epr)": "Punkte vom Auge aus (epr)",
    "Points per Pixel": "Punkte je Pixel",
    "Map Memory": "Speicher für Karten",
    "Preview": "Vorschau",
    "Display": "Anzeige",
    "Blended": "Verrechnet",
    "Pass": "Pass",
    "Difference": "Unterschied",
    "All": "Alle",
    "Shadows": "Schatten",
    "Reflection": "Spiegelung",
    "Reflection Color": "Farbe der Spiegelung",
    "Reflected Light": "Gespiegeltes Licht",
    "Time Slice": "Zeitscheibe",
    "Shadow Pass": "Schattenpass",
    "Own Views": "Eigene Ansichten",
    "Reflector": "Spiegel",
    "Never": "Nie",
    "Always": "Immer",
    "VIR Passes": "VIR-Pässe",
    "Lights": "Lichter",
    "Reflectors": "Spiegel",
    "F12 and Animation": "F12 und Animation",
    "Notes": "Hinweise",
    "Effects": "Effekte",
    "Passes": "Pässe",
    "Click a light for details": "Ein Licht anklicken, um mehr zu sehen",
    "Lock Interface while Rendering": "Oberfläche beim Rendern sperren",
    "Nothing reflects": "Nichts spiegelt",
    "Not planned yet": "Noch nicht geplant",
    "With Blender's own graphics": "Mit Blenders eigener Grafik",
    "This viewport shows no overlays": "Dieses Fenster zeigt keine Überlagerungen",
    # tooltips
    "Make the passes of every frame that Blender renders, before its compositor runs. Switches Lock Interface on": (
        "Die Pässe jedes Bildes erzeugen, das Blender rendert, bevor sein Compositor läuft. Schaltet die Sperre der Oberfläche ein"
    ),
    "One shadow pass for each area light and sun": "Ein Schattenpass für jedes Flächenlicht und jede Sonne",
    "One shadow pass for each point light and spot": "Ein Schattenpass für jedes Punktlicht und jeden Spot",
    "What mirroring surfaces show, and the colour that it is multiplied by": (
        "Was spiegelnde Oberflächen zeigen, und die Farbe, mit der es multipliziert wird"
    ),
    "What computes the passes": "Was die Pässe berechnet",
    "OpenGL where it can be had, otherwise Blender's own graphics": "OpenGL, wo es das gibt, sonst Blenders eigene Grafik",
    "OpenGL 4.3 in a context of its own. Not on macOS": "OpenGL 4.3 in einem eigenen Kontext. Nicht unter macOS",
    "Blender's own graphics module. Needs Blender 5.2": "Blenders eigenes Grafikmodul. Braucht Blender 5.2",
    "From fast to exact: sets the number of views and the resolution of maps. Twice the views take about twice the time": (
        "Von schnell bis genau: Zahl der Ansichten und Auflösung der Karten. Doppelt so viele Ansichten dauern etwa doppelt so lange"
    ),
    "Places on each light with a size that it is looked from. Noise and banding fall with their number": (
        "Stellen auf jedem Licht mit einer Größe, von denen aus geschaut wird. Je mehr, desto weniger Rauschen und Streifen"
    ),
    "Width and height of depth maps. Finer maps keep contacts and thin things": (
        "Breite und Höhe der Tiefenkarten. Feinere Karten erhalten Berührungen und dünne Dinge"
    ),
    "How depth maps are made": "Wie Tiefenkarten entstehen",
    "For every light what is predicted to be fastest": "Für jedes Licht, was voraussichtlich am schnellsten ist",
    "Rasterize small triangles in a kernel: fastest with many triangles": (
        "Kleine Dreiecke in einem Rechenkern rasterisieren: am schnellsten bei vielen Dreiecken"
    ),
    "Rasterize the scene for every view: fastest with few large triangles": (
        "Die Szene für jede Ansicht rasterisieren: am schnellsten bei wenigen großen Dreiecken"
    ),
    "Splat one cloud of points into every view": "Eine Punktwolke in jede Ansicht werfen",
    "Points of small triangles, large triangles rasterized": "Punkte kleiner Dreiecke, große werden rasterisiert",
    "Points as first published, to compare with. Not for suns": "Punkte wie zuerst veröffentlicht, zum Vergleich. Nicht für Sonnen",
    "Warp one view from behind the light, to compare with. Area lights only; not with the device Blender": (
        "Eine Ansicht von hinter dem Licht verformen, zum Vergleich. Nur Flächenlichter; nicht mit dem Gerät Blender"
    ),
    "Points as fine as the picture needs them. Point lights and spots only": (
        "Punkte so fein, wie das Bild sie braucht. Nur Punktlichter und Spots"
    ),
    "One filtered map for each light: quick, and wrong where blockers are close": (
        "Eine gefilterte Karte je Licht: schnell, und falsch, wo das Verdeckende nah ist"
    ),
    "How often pixels are looked up in depth maps": "Wie oft Pixel in Tiefenkarten nachgeschlagen werden",
    "Full on a GPU, adaptive on a software rasterizer: whichever is faster": (
        "Vollständig auf einer GPU, angepasst ohne: je nachdem, was schneller ist"
    ),
    "Parts of the picture that are wholly lit or dark are only probed. Error below 0.002": (
        "Ganz helle und ganz dunkle Teile des Bildes werden nur stichprobenweise geprüft. Fehler unter 0,002"
    ),
    "Every pixel is looked up in every view": "Jedes Pixel wird in jeder Ansicht nachgeschlagen",
    "Whether points are kept between batches of views: IVIR, Hybrid, VWSS and EPR": (
        "Ob Punkte von einem Stapel Ansichten zum nächsten aufgehoben werden: IVIR, Gemischt, VWSS und EPR"
    ),
    "Points are made once and kept for all views": "Punkte entstehen einmal und bleiben für alle Ansichten",
    "Points are made again for every batch of views, which takes less memory": (
        "Punkte entstehen für jeden Stapel Ansichten neu; das braucht weniger Speicher"
    ),
    "What makes points: IVIR": "Was Punkte erzeugt: IVIR",
    "Compute kernels make the points": "Rechenkerne erzeugen die Punkte",
    "Geometry shader and rasterizer, as published. Not with the device Blender": (
        "Geometrie-Shader und Rasterisierer, wie veröffentlicht. Nicht mit dem Gerät Blender"
    ),
    "Leave out triangles far smaller than a texel at random: IVIR, Hybrid and EPR": (
        "Dreiecke, die viel kleiner als ein Texel sind, zufällig auslassen: IVIR, Gemischt und EPR"
    ),
    "Triangles of a smaller area, in texels, are culled at random": "Dreiecke mit kleinerer Fläche, in Texeln, werden zufällig ausgelassen",
    "After the first batch of views, leave out what none of them is near to seeing": (
        "Nach dem ersten Stapel Ansichten auslassen, was keine von ihnen auch nur beinahe sieht"
    ),
    "Points so dense that no texel stays empty, instead of the published one for each pixel's area": (
        "Punkte so dicht, dass kein Texel leer bleibt, statt des veröffentlichten einen je Pixelfläche"
    ),
    "Triangles that take more points are rasterized: Hybrid": "Dreiecke, die mehr Punkte brauchen, werden rasterisiert: Gemischt",
    "Points of back faces as well: VWSS": "Auch Punkte der Rückseiten: VWSS",
    "Maps that one thread writes a point into: VWSS": "Karten, in die ein Thread einen Punkt schreibt: VWSS",
    "Samples of the map that search for blockers: PCSS": "Stichproben der Karte, die Verdeckendes suchen: PCSS",
    "Samples of the filter that makes the penumbra: PCSS": "Stichproben des Filters, der den Halbschatten macht: PCSS",
    "MiB for what views share: points, small triangles. What does not fit is made again for every batch of views": (
        "MiB für das, was Ansichten gemeinsam haben: Punkte, kleine Dreiecke. Was nicht hineinpasst, entsteht für jeden Stapel neu"
    ),
    "How often light is followed from reflector to reflector. 0: as often as the scene calls for, at most twice": (
        "Wie oft Licht von Spiegel zu Spiegel verfolgt wird. 0: so oft, wie die Szene es verlangt, höchstens zweimal"
    ),
    "One mirrored view for each flat reflector, exact and cheap. Off: cubes as all others have, to compare with": (
        "Eine gespiegelte Ansicht je ebenem Spiegel, genau und günstig. Aus: Würfel wie bei allen anderen, zum Vergleichen"
    ),
    "How reflectors' maps are looked up": "Wie in den Karten der Spiegel nachgeschlagen wird",
    "Rays are followed through the depths of a reflector's map: things are where they belong": (
        "Strahlen werden durch die Tiefen der Karte eines Spiegels verfolgt: Dinge sind, wo sie hingehören"
    ),
    "As if all were infinitely far away, as published: things slide. To compare with": (
        "Als wäre alles unendlich weit weg, wie veröffentlicht: Dinge verrutschen. Zum Vergleich"
    ),
    "A pair of reflection passes of each reflecting object besides": "Dazu zwei Spiegelungspässe für jedes spiegelnde Objekt",
    "How cubes of what reflectors show are made": "Wie die Würfel entstehen mit dem, was Spiegel zeigen",
    "Whichever is quicker in the scene": "Was in der Szene schneller ist",
    "The rasterizer draws the scene for every face of every reflector's cube": (
        "Der Rasterisierer zeichnet die Szene für jede Seite des Würfels jedes Spiegels"
    ),
    "One cloud of points for all cubes, as dense as the nearest of them needs": (
        "Eine Punktwolke für alle Würfel, so dicht, wie der nächste von ihnen sie braucht"
    ),
    "One cloud of splats for all cubes, no denser than the picture shows": (
        "Eine Wolke von Flecken für alle Würfel, nicht dichter, als das Bild zeigt"
    ),
    "Of eye-based points: fewer of them are larger splats": "Bei Punkten vom Auge aus: weniger sind größere Flecken",
    "MiB for the maps of all reflectors. Where they would take more they get smaller": (
        "MiB für die Karten aller Spiegel. Wo sie mehr bräuchten, werden sie kleiner"
    ),
    "Show the passes over the 3D viewport and refine them while nothing moves": (
        "Die Pässe über dem 3D-Fenster zeigen und verfeinern, solange sich nichts bewegt"
    ),
    "How the preview shows its passes": "Wie die Vorschau ihre Pässe zeigt",
    "Darken the viewport where there is shadow, and add the light that reflectors add": (
        "Das Fenster verdunkeln, wo Schatten ist, und das Licht hinzufügen, das Spiegel hinzufügen"
    ),
    "The pass itself: of shadows, white is lit and black is shadow": "Der Pass selbst: bei Schatten ist Weiß hell und Schwarz Schatten",
    "What changes make of the first complete picture of a view: orange is lighter, blue darker": (
        "Was Änderungen aus dem ersten fertigen Bild einer Ansicht machen: Orange ist heller, Blau dunkler"
    ),
    "Which passes the preview shows, of the effects that are switched on": ("Welche Pässe der eingeschalteten Effekte die Vorschau zeigt"),
    "Shadows, and the light that reflectors add": "Schatten, und das Licht, das Spiegel hinzufügen",
    "Of all lights, or of the one that is chosen": "Aller Lichter, oder des gewählten",
    "What reflectors show": "Was Spiegel zeigen",
    "What the reflection is multiplied by": "Womit die Spiegelung multipliziert wird",
    "What reflectors add to the picture: the former two multiplied": (
        "Was Spiegel dem Bild hinzufügen: die beiden vorigen miteinander multipliziert"
    ),
    "The light whose shadows the preview shows. Empty: those of all lights together": (
        "Das Licht, dessen Schatten die Vorschau zeigt. Leer: die aller Lichter zusammen"
    ),
    "Milliseconds that the preview may take from Blender at a time. If not set, 30 on a GPU and 300 without one": (
        "Millisekunden, die die Vorschau Blender am Stück nehmen darf. Wenn nicht gesetzt, 30 auf einer GPU und 300 ohne"
    ),
    "Make a shadow pass of this light. Without, its pass is white": "Einen Schattenpass dieses Lichts machen. Ohne ist sein Pass weiß",
    "Give this light a number of views of its own instead of the scene's": (
        "Diesem Licht eine eigene Zahl von Ansichten geben statt der Zahl der Szene"
    ),
    "Places on this light that it is looked from, instead of the scene's number": (
        "Stellen auf diesem Licht, von denen aus geschaut wird, statt der Zahl der Szene"
    ),
    "Whether this object reflects others": "Ob dieses Objekt andere spiegelt",
    "Its materials decide": "Seine Materialien entscheiden",
    "Not a reflector, whatever its materials are": "Kein Spiegel, was immer seine Materialien sind",
    "A reflector, whatever its materials are": "Ein Spiegel, was immer seine Materialien sind",
    "Look at the scene and say what would be rendered and why, without rendering it": (
        "Die Szene ansehen und sagen, was gerendert würde und warum, ohne es zu rendern"
    ),
    "Render the passes of the current frame into images. Esc cancels and keeps what was there before": (
        "Die Pässe des aktuellen Bildes in Bilder rendern. Esc bricht ab und behält, was vorher da war"
    ),
    "Stop rendering the passes. The images keep what was in them before": (
        "Das Rendern der Pässe abbrechen. Die Bilder behalten, was vorher in ihnen war"
    ),
    "Add a node with every pass as an output to the scene's compositor. Your own nodes and links stay as they are": (
        "Dem Compositor der Szene einen Knoten mit jedem Pass als Ausgang hinzufügen. Eigene Knoten und Verbindungen bleiben, wie sie sind"
    ),
    "Show how the passes were made in the web browser: times, methods, errors, what was left out and why": (
        "Im Browser zeigen, wie die Pässe entstanden: Zeiten, Verfahren, Fehler, was ausgelassen wurde und warum"
    ),
    "Keep the current settings as a preset of your own, or remove one": (
        "Die jetzigen Einstellungen als eigene Voreinstellung behalten, oder eine entfernen"
    ),
    "Show the passes over the 3D viewport, or stop showing them": "Die Pässe über dem 3D-Fenster zeigen, oder nicht mehr zeigen",
}
_GERMAN_OPERATORS = {
    "Plan": "Planen",
    "Render Passes": "Pässe rendern",
    "Cancel": "Abbrechen",
    "Add to Compositor": "Zum Compositor hinzufügen",
    "Open Report": "Bericht öffnen",
    "Add VIR Preset": "VIR-Voreinstellung hinzufügen",
    "Preview Passes": "Pässe als Vorschau",
}

TRANSLATIONS = {
    "de_DE": {
        **{(_ANY, text): translated for text, translated in _GERMAN.items()},
        **{(_OPERATOR, text): translated for text, translated in _GERMAN_OPERATORS.items()},
    }
}
"""locale -> (context, English) -> translated"""


def register() -> None:
    bpy.app.translations.register(__name__, TRANSLATIONS)


def unregister() -> None:
    bpy.app.translations.unregister(__name__)
