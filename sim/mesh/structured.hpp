#pragma once
#include <functional>
#include <string>
#include <vector>

#include "sim/mesh/mesh.hpp"

namespace taut {

/// Coordinates 0..length in `cells` steps whose sizes form a geometric progression: last/first = `ratio`.
/// ratio = 1 is uniform; ratio > 1 makes the cells at 0 the finest. Errors: InputError for cells < 1 or ratio <= 0.
std::vector<double> graded(double length, int cells, double ratio = 1.0);

/// How many cells of about `size` a length takes, `at_least` so many.
int cells_along(double length, double size, int at_least = 1);

/// Appends `cells` equal steps up to `end`, which is exact.
void step_to(std::vector<double>& x, double end, int cells);

/// Which way the cells of a rectangle are cut in two. Alternating diagonals favour no direction; all rising (lower left
/// to upper right) or all falling ones are what many mesh generators make, and linear elements suffer for it.
enum class Diagonals { alternating, rising, falling };

/// Rectangle meshed as a grid at the given coordinates, two triangles per cell. Tags: xmin, xmax, ymin, ymax. One
/// region.
Mesh rectangle(const std::vector<double>& x, const std::vector<double>& y, int order, const std::string& region,
               Diagonals diagonals = Diagonals::alternating);

/// Box meshed as a grid at the given coordinates, six tetrahedra per cell (Kuhn's subdivision, so faces match),
/// mirrored from cell to cell so that no diagonal direction is favoured. Tags: xmin, xmax, ymin, ymax, zmin, zmax.
Mesh box(const std::vector<double>& x, const std::vector<double>& y, const std::vector<double>& z, int order,
         const std::string& region);

/// Moves every vertex by `map` and, on quadratic meshes, puts mid-nodes back on straight edges: Cook's membrane from a
/// square, an irregular patch from a regular one.
void map_vertices(Mesh& mesh, const std::function<Eigen::VectorXd(const Eigen::VectorXd&)>& map);

/// The elements whose centroid `keep` accepts, and the nodes and tagged entities that are theirs.
Mesh part_of(const Mesh& whole, const std::function<bool(const Eigen::VectorXd&)>& keep);

/// Gives each element the region that `name_at(centroid)` returns.
void assign_regions(Mesh& mesh, const std::function<std::string(const Eigen::VectorXd&)>& name_at);

}  // namespace taut
