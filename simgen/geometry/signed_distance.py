"""Signed distance fields of rigid shapes: distance, normal and curvature as Warp functions for CPU and GPU.

Lengths in mm, float64. The indenter frame has the tip plane y = 0 and the press direction +y. Analytic shapes extend
to infinity towards -y.

Each analytic shape joins distances to simple parts (a slab, a round core) by a rounded intersection. The gradients of
the parts are orthogonal. Then the formula of Quilez ("Distance functions", iquilezles.org) is the exact distance to the
filleted solid, inside and outside. So its gradient is a unit vector, and its Hessian is the curvature of the level set.
"""

import enum

import warp as wp

wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)  # no banner, no line per compiled kernel


class Kind(enum.IntEnum):
    """Kind of a RigidShape. The comments give its ``size``, mm."""

    SPHERE = 0  # radius
    CYLINDER = 1  # radius, half length along x, fillet
    CUBE = 2  # half width, fillet
    RING = 3  # outer radius, hole radius, fillet
    TEXTURE = 4  # half width, fillet, bump radius, bump offset along x and z
    SAMPLED = 5  # no size; the shape is the zero level of a cubic B-spline


@wp.struct
class RigidShape:
    """A rigid shape, in mm. Only ``Kind.SAMPLED`` uses the grid.

    ``coefficients[i, j, k]`` belongs to the grid point ``grid_origin + grid_spacing * (i, j, k)``.
    """

    kind: wp.int32
    size: wp.vec4d
    grid_origin: wp.vec3d
    grid_spacing: wp.float64
    coefficients: wp.array3d(dtype=wp.float64)


@wp.struct
class Probe:
    """Signed distance (mm, negative inside) at a point, its gradient and its Hessian (1/mm)."""

    distance: wp.float64
    normal: wp.vec3d
    curvature: wp.mat33d


@wp.func
def _slab(coordinate: wp.float64, half_width: wp.float64, axis: wp.vec3d) -> Probe:
    """``|coordinate| - half_width`` of a coordinate along ``axis``."""
    result = Probe()
    result.distance = wp.abs(coordinate) - half_width
    result.normal = wp.where(coordinate < wp.float64(0.0), -axis, axis)
    return result


@wp.func
def _below(height: wp.float64) -> Probe:
    """The half space under the tip plane."""
    result = Probe()
    result.distance = height
    result.normal = wp.vec3d(wp.float64(0.0), wp.float64(1.0), wp.float64(0.0))
    return result


@wp.func
def _round(offset: wp.vec3d, active: wp.vec3d, radius: wp.float64) -> Probe:
    """``|offset| - radius``; ``active`` is 1 for each coordinate on which the offset depends, else 0."""
    result = Probe()
    length = wp.max(wp.length(offset), wp.float64(1.0e-9))
    result.distance = length - radius
    result.normal = offset / length
    result.curvature = (wp.diag(active) - wp.outer(result.normal, result.normal)) / length
    return result


@wp.func
def _shell(middle: Probe, half_thickness: wp.float64) -> Probe:
    """``|middle| - half_thickness``."""
    result = Probe()
    result.distance = wp.abs(middle.distance) - half_thickness
    sign = wp.where(middle.distance < wp.float64(0.0), wp.float64(-1.0), wp.float64(1.0))
    result.normal = sign * middle.normal
    result.curvature = sign * middle.curvature
    return result


@wp.func
def _rounded_intersection(a: Probe, b: Probe, fillet: wp.float64) -> Probe:
    """``|max(q, 0)| + min(max q, 0) - fillet``, ``q = distance + fillet``, gradients orthogonal."""
    qa = a.distance + fillet
    qb = b.distance + fillet
    result = Probe()
    if wp.min(qa, qb) > wp.float64(0.0):
        length = wp.sqrt(qa * qa + qb * qb)
        result.distance = length - fillet
        result.normal = (qa * a.normal + qb * b.normal) / length
        result.curvature = (
            qa * a.curvature
            + qb * b.curvature
            + wp.outer(a.normal, a.normal)
            + wp.outer(b.normal, b.normal)
            - wp.outer(result.normal, result.normal)
        ) / length
    elif qa > qb:
        result = a
    else:
        result = b
    return result


@wp.func
def _sphere(x: wp.vec3d, radius: wp.float64) -> Probe:
    """A hemispherical tip with a round shaft: all points within the radius of a ray along -y."""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    height = x[1] + radius
    active = wp.vec3d(one, one, one)
    if height < zero:
        active = wp.vec3d(one, zero, one)
    return _round(wp.vec3d(x[0], wp.max(height, zero), x[2]), active, radius)


@wp.func
def _cylinder(x: wp.vec3d, radius: wp.float64, half_length: wp.float64, fillet: wp.float64) -> Probe:
    zero, one = wp.float64(0.0), wp.float64(1.0)
    height = x[1] + radius
    active = wp.vec3d(zero, one, one)
    if height < zero:
        active = wp.vec3d(zero, zero, one)
    profile = _round(wp.vec3d(zero, wp.max(height, zero), x[2]), active, radius)
    return _rounded_intersection(profile, _slab(x[0], half_length, wp.vec3d(one, zero, zero)), fillet)


@wp.func
def _cube(x: wp.vec3d, half_width: wp.float64, fillet: wp.float64) -> Probe:
    zero, one = wp.float64(0.0), wp.float64(1.0)
    column = _rounded_intersection(
        _slab(x[0], half_width, wp.vec3d(one, zero, zero)),
        _slab(x[2], half_width, wp.vec3d(zero, zero, one)),
        fillet,
    )
    return _rounded_intersection(column, _below(x[1]), fillet)


@wp.func
def _ring(x: wp.vec3d, outer: wp.float64, hole: wp.float64, fillet: wp.float64) -> Probe:
    zero, one = wp.float64(0.0), wp.float64(1.0)
    half = wp.float64(0.5)
    middle = _round(wp.vec3d(x[0], zero, x[2]), wp.vec3d(one, zero, one), half * (outer + hole))
    return _rounded_intersection(_shell(middle, half * (outer - hole)), _below(x[1]), fillet)


@wp.func
def _texture(x: wp.vec3d, half_width: wp.float64, fillet: wp.float64, bump: wp.float64, offset: wp.float64) -> Probe:
    """A cube whose face lies one bump radius below the tip plane, with five hemispheres on it.

    The union takes the nearest part. It is exact outside, and a bound inside near the creases.
    """
    zero = wp.float64(0.0)
    nearest = _cube(wp.vec3d(x[0], x[1] + bump, x[2]), half_width, fillet)
    # By symmetry the nearest of the four outer bumps is the one in the point's own quadrant.
    ox = wp.where(x[0] < zero, -offset, offset)
    oz = wp.where(x[2] < zero, -offset, offset)
    outer = _sphere(wp.vec3d(x[0] - ox, x[1], x[2] - oz), bump)
    if outer.distance < nearest.distance:
        nearest = outer
    centre = _sphere(x, bump)
    if centre.distance < nearest.distance:
        nearest = centre
    return nearest


@wp.func
def _weights(t: wp.float64) -> wp.vec4d:
    """Weights of a uniform cubic B-spline at the four grid points around fraction t of a cell."""
    one = wp.float64(1.0)
    three = wp.float64(3.0)
    u = one - t
    return wp.vec4d(
        u * u * u,
        three * t * t * t - wp.float64(6.0) * t * t + wp.float64(4.0),
        three * u * u * u - wp.float64(6.0) * u * u + wp.float64(4.0),
        t * t * t,
    ) / wp.float64(6.0)


@wp.func
def _slopes(t: wp.float64) -> wp.vec4d:
    """First derivative of `_weights`."""
    u = wp.float64(1.0) - t
    a = wp.float64(1.5)
    b = wp.float64(2.0)
    half = wp.float64(0.5)
    return wp.vec4d(-half * u * u, a * t * t - b * t, b * u - a * u * u, half * t * t)


@wp.func
def _bends(t: wp.float64) -> wp.vec4d:
    """Second derivative of `_weights`."""
    u = wp.float64(1.0) - t
    a = wp.float64(3.0)
    b = wp.float64(2.0)
    return wp.vec4d(u, a * t - b, a * u - b, t)


@wp.struct
class Cell:
    """The place of a point in a shape's grid, or of the nearest point of the grid."""

    corner: wp.vec3i
    fraction: wp.vec3d
    excess: wp.vec3d  # mm, from the grid to the point


@wp.func
def _cell(shape: RigidShape, x: wp.vec3d) -> Cell:
    position = (x - shape.grid_origin) / shape.grid_spacing
    cell = Cell()
    for axis in range(3):
        # The last cell needs the outermost layer of coefficients.
        last = shape.coefficients.shape[axis] - 2
        inside = wp.clamp(position[axis], wp.float64(1.0), wp.float64(last))
        corner = wp.min(wp.int32(wp.floor(inside)), last - 1)
        cell.corner[axis] = corner
        cell.fraction[axis] = inside - wp.float64(corner)
        cell.excess[axis] = shape.grid_spacing * (position[axis] - inside)
    return cell


@wp.func
def _sampled_distance(shape: RigidShape, x: wp.vec3d) -> wp.float64:
    """The distance of `_sampled`, at a quarter of its cost."""
    cell = _cell(shape, x)
    t = cell.fraction
    wx, wy, wz = _weights(t[0]), _weights(t[1]), _weights(t[2])
    value = wp.float64(0.0)
    for i in range(4):
        for j in range(4):
            value += wx[i] * wy[j] * wp.dot(_taps(shape, cell.corner, i, j), wz)
    return value + wp.length(cell.excess)


@wp.func
def _taps(shape: RigidShape, corner: wp.vec3i, i: wp.int32, j: wp.int32) -> wp.vec4d:
    """The four coefficients of a row along z."""
    taps = wp.vec4d()
    for k in range(4):
        taps[k] = shape.coefficients[corner[0] + i - 1, corner[1] + j - 1, corner[2] + k - 1]
    return taps


@wp.func
def _sampled(shape: RigidShape, x: wp.vec3d) -> Probe:
    """Cubic B-spline. Outside the grid: the value at the nearest point of the grid plus the distance to it."""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    h = shape.grid_spacing
    cell = _cell(shape, x)
    t = cell.fraction
    active = wp.vec3d(one, one, one)
    for axis in range(3):
        active[axis] = wp.where(cell.excess[axis] == zero, one, zero)
    wx, wy, wz = _weights(t[0]), _weights(t[1]), _weights(t[2])
    sx, sy, sz = _slopes(t[0]), _slopes(t[1]), _slopes(t[2])
    bx, by, bz = _bends(t[0]), _bends(t[1]), _bends(t[2])
    # Sum along z, then y, then x: a ninth of the cost of 64 products for each derivative.
    value = wp.float64(0.0)
    gradient = wp.vec3d()
    xx, yy, zz = wp.float64(0.0), wp.float64(0.0), wp.float64(0.0)
    xy, xz, yz = wp.float64(0.0), wp.float64(0.0), wp.float64(0.0)
    for i in range(4):
        f, fy, fz = wp.float64(0.0), wp.float64(0.0), wp.float64(0.0)
        fyy, fyz, fzz = wp.float64(0.0), wp.float64(0.0), wp.float64(0.0)
        for j in range(4):
            taps = _taps(shape, cell.corner, i, j)
            plain, slope, bend = wp.dot(taps, wz), wp.dot(taps, sz), wp.dot(taps, bz)
            f += wy[j] * plain
            fy += sy[j] * plain
            fz += wy[j] * slope
            fyy += by[j] * plain
            fyz += sy[j] * slope
            fzz += wy[j] * bend
        value += wx[i] * f
        gradient += wp.vec3d(sx[i] * f, wx[i] * fy, wx[i] * fz)
        xx += bx[i] * f
        yy += wx[i] * fyy
        zz += wx[i] * fzz
        xy += sx[i] * fy
        xz += sx[i] * fz
        yz += wx[i] * fyz
    hessian = wp.mat33d(xx, xy, xz, xy, yy, yz, xz, yz, zz)

    result = Probe()
    result.distance = value
    result.normal = wp.cw_mul(active, gradient) / h
    result.curvature = wp.cw_mul(wp.outer(active, active), hessian) / (h * h)
    outside = wp.length(cell.excess)
    if outside > zero:
        away = cell.excess / outside
        passive = wp.vec3d(one, one, one) - active
        result.distance += outside
        result.normal += away
        result.curvature += (wp.diag(passive) - wp.outer(away, away)) / outside
    return result


@wp.func
def probe(shape: RigidShape, x: wp.vec3d) -> Probe:
    """Signed distance (mm), normal and curvature (1/mm) of ``shape`` at ``x`` (mm, the shape's own frame)."""
    s = shape.size
    result = Probe()
    if shape.kind == Kind.SPHERE:
        result = _sphere(x, s[0])
    elif shape.kind == Kind.CYLINDER:
        result = _cylinder(x, s[0], s[1], s[2])
    elif shape.kind == Kind.CUBE:
        result = _cube(x, s[0], s[1])
    elif shape.kind == Kind.RING:
        result = _ring(x, s[0], s[1], s[2])
    elif shape.kind == Kind.TEXTURE:
        result = _texture(x, s[0], s[1], s[2], s[3])
    else:
        result = _sampled(shape, x)
    return result


@wp.func
def distance(shape: RigidShape, x: wp.vec3d) -> wp.float64:
    """Signed distance (mm) as by `probe`, without normal and curvature."""
    if shape.kind == Kind.SAMPLED:
        return _sampled_distance(shape, x)
    return probe(shape, x).distance
