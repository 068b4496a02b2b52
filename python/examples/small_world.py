"""A small world: built, read, and the places of its vacancies."""

import stemworlds as sw

recipe = sw.Recipe("test", grid=(1, 1)).set({"vacancies.rate": 0.1, "field.thickness_nm": 0.4})
world = sw.build(recipe, out="small.h5", cache=False, audit=0)
tile = world.tile(0, 0)
print(f"{tile.array.shape} pixels of {world.pixel_nm} nm, {world.metadata.site_count} sites")

table = world.truth_table()
vacant = table.array[table["vacancies"] > 0]
for column in vacant[:5]:
    print(f"row {column['y_px']:6.1f}, column {column['x_px']:6.1f}: {column['composition']}")

try:
    recipe.set("vacancies.rate", 3)
except sw.InvalidValue as error:
    print(error)
