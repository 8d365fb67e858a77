from google.protobuf import struct_pb2 as _struct_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class DepthEncoding(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    DEPTH_ENCODING_UNSPECIFIED: _ClassVar[DepthEncoding]
    DEPTH_ENCODING_PNG16: _ClassVar[DepthEncoding]
    DEPTH_ENCODING_NPY: _ClassVar[DepthEncoding]
    DEPTH_ENCODING_16UC1: _ClassVar[DepthEncoding]
    DEPTH_ENCODING_32FC1: _ClassVar[DepthEncoding]
    DEPTH_ENCODING_COMPRESSED_DEPTH: _ClassVar[DepthEncoding]

class MaskEncoding(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    MASK_ENCODING_UNSPECIFIED: _ClassVar[MaskEncoding]
    MASK_ENCODING_PNG8: _ClassVar[MaskEncoding]

class DisplacementForm(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    DISPLACEMENT_FORM_UNSPECIFIED: _ClassVar[DisplacementForm]
    DISPLACEMENT_FORM_GRID: _ClassVar[DisplacementForm]
    DISPLACEMENT_FORM_VOXELS: _ClassVar[DisplacementForm]
DEPTH_ENCODING_UNSPECIFIED: DepthEncoding
DEPTH_ENCODING_PNG16: DepthEncoding
DEPTH_ENCODING_NPY: DepthEncoding
DEPTH_ENCODING_16UC1: DepthEncoding
DEPTH_ENCODING_32FC1: DepthEncoding
DEPTH_ENCODING_COMPRESSED_DEPTH: DepthEncoding
MASK_ENCODING_UNSPECIFIED: MaskEncoding
MASK_ENCODING_PNG8: MaskEncoding
DISPLACEMENT_FORM_UNSPECIFIED: DisplacementForm
DISPLACEMENT_FORM_GRID: DisplacementForm
DISPLACEMENT_FORM_VOXELS: DisplacementForm

class DeformRequest(_message.Message):
    __slots__ = ("camera", "depth", "mask", "up", "roi", "shape", "material", "loads", "outputs", "threshold", "uncertainty_samples", "reconstruction_id", "displacement_form")
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    DEPTH_FIELD_NUMBER: _ClassVar[int]
    MASK_FIELD_NUMBER: _ClassVar[int]
    UP_FIELD_NUMBER: _ClassVar[int]
    ROI_FIELD_NUMBER: _ClassVar[int]
    SHAPE_FIELD_NUMBER: _ClassVar[int]
    MATERIAL_FIELD_NUMBER: _ClassVar[int]
    LOADS_FIELD_NUMBER: _ClassVar[int]
    OUTPUTS_FIELD_NUMBER: _ClassVar[int]
    THRESHOLD_FIELD_NUMBER: _ClassVar[int]
    UNCERTAINTY_SAMPLES_FIELD_NUMBER: _ClassVar[int]
    RECONSTRUCTION_ID_FIELD_NUMBER: _ClassVar[int]
    DISPLACEMENT_FORM_FIELD_NUMBER: _ClassVar[int]
    camera: Camera
    depth: DepthImage
    mask: MaskImage
    up: Vector3
    roi: Region
    shape: KnownShape
    material: Material
    loads: _containers.RepeatedCompositeFieldContainer[Load]
    outputs: Outputs
    threshold: float
    uncertainty_samples: int
    reconstruction_id: str
    displacement_form: DisplacementForm
    def __init__(self, camera: _Optional[_Union[Camera, _Mapping]] = ..., depth: _Optional[_Union[DepthImage, _Mapping]] = ..., mask: _Optional[_Union[MaskImage, _Mapping]] = ..., up: _Optional[_Union[Vector3, _Mapping]] = ..., roi: _Optional[_Union[Region, _Mapping]] = ..., shape: _Optional[_Union[KnownShape, _Mapping]] = ..., material: _Optional[_Union[Material, _Mapping]] = ..., loads: _Optional[_Iterable[_Union[Load, _Mapping]]] = ..., outputs: _Optional[_Union[Outputs, _Mapping]] = ..., threshold: _Optional[float] = ..., uncertainty_samples: _Optional[int] = ..., reconstruction_id: _Optional[str] = ..., displacement_form: _Optional[_Union[DisplacementForm, str]] = ...) -> None: ...

class Camera(_message.Message):
    __slots__ = ("fx", "fy", "cx", "cy", "width", "height", "distortion")
    FX_FIELD_NUMBER: _ClassVar[int]
    FY_FIELD_NUMBER: _ClassVar[int]
    CX_FIELD_NUMBER: _ClassVar[int]
    CY_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    DISTORTION_FIELD_NUMBER: _ClassVar[int]
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, fx: _Optional[float] = ..., fy: _Optional[float] = ..., cx: _Optional[float] = ..., cy: _Optional[float] = ..., width: _Optional[int] = ..., height: _Optional[int] = ..., distortion: _Optional[_Iterable[float]] = ...) -> None: ...

class DepthImage(_message.Message):
    __slots__ = ("encoding", "unit_m", "data", "ros_format")
    ENCODING_FIELD_NUMBER: _ClassVar[int]
    UNIT_M_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    ROS_FORMAT_FIELD_NUMBER: _ClassVar[int]
    encoding: DepthEncoding
    unit_m: float
    data: bytes
    ros_format: str
    def __init__(self, encoding: _Optional[_Union[DepthEncoding, str]] = ..., unit_m: _Optional[float] = ..., data: _Optional[bytes] = ..., ros_format: _Optional[str] = ...) -> None: ...

class MaskImage(_message.Message):
    __slots__ = ("encoding", "data")
    ENCODING_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    encoding: MaskEncoding
    data: bytes
    def __init__(self, encoding: _Optional[_Union[MaskEncoding, str]] = ..., data: _Optional[bytes] = ...) -> None: ...

class Vector3(_message.Message):
    __slots__ = ("x", "y", "z")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    z: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ...) -> None: ...

class Pixel(_message.Message):
    __slots__ = ("u", "v")
    U_FIELD_NUMBER: _ClassVar[int]
    V_FIELD_NUMBER: _ClassVar[int]
    u: float
    v: float
    def __init__(self, u: _Optional[float] = ..., v: _Optional[float] = ...) -> None: ...

class Region(_message.Message):
    __slots__ = ("u", "v", "width", "height")
    U_FIELD_NUMBER: _ClassVar[int]
    V_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    u: int
    v: int
    width: int
    height: int
    def __init__(self, u: _Optional[int] = ..., v: _Optional[int] = ..., width: _Optional[int] = ..., height: _Optional[int] = ...) -> None: ...

class KnownShape(_message.Message):
    __slots__ = ("data", "voxel_size_m", "camera_from_grid")
    DATA_FIELD_NUMBER: _ClassVar[int]
    VOXEL_SIZE_M_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FROM_GRID_FIELD_NUMBER: _ClassVar[int]
    data: bytes
    voxel_size_m: float
    camera_from_grid: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, data: _Optional[bytes] = ..., voxel_size_m: _Optional[float] = ..., camera_from_grid: _Optional[_Iterable[float]] = ...) -> None: ...

class Material(_message.Message):
    __slots__ = ("name", "young_modulus_pa", "poisson_ratio")
    NAME_FIELD_NUMBER: _ClassVar[int]
    YOUNG_MODULUS_PA_FIELD_NUMBER: _ClassVar[int]
    POISSON_RATIO_FIELD_NUMBER: _ClassVar[int]
    name: str
    young_modulus_pa: float
    poisson_ratio: float
    def __init__(self, name: _Optional[str] = ..., young_modulus_pa: _Optional[float] = ..., poisson_ratio: _Optional[float] = ...) -> None: ...

class Load(_message.Message):
    __slots__ = ("force_n", "contact_m", "contact_px", "patch_radius_m")
    FORCE_N_FIELD_NUMBER: _ClassVar[int]
    CONTACT_M_FIELD_NUMBER: _ClassVar[int]
    CONTACT_PX_FIELD_NUMBER: _ClassVar[int]
    PATCH_RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    force_n: Vector3
    contact_m: Vector3
    contact_px: Pixel
    patch_radius_m: float
    def __init__(self, force_n: _Optional[_Union[Vector3, _Mapping]] = ..., contact_m: _Optional[_Union[Vector3, _Mapping]] = ..., contact_px: _Optional[_Union[Pixel, _Mapping]] = ..., patch_radius_m: _Optional[float] = ...) -> None: ...

class Outputs(_message.Message):
    __slots__ = ("reconstruction", "deformed", "probability", "displacement", "scene")
    RECONSTRUCTION_FIELD_NUMBER: _ClassVar[int]
    DEFORMED_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    DISPLACEMENT_FIELD_NUMBER: _ClassVar[int]
    SCENE_FIELD_NUMBER: _ClassVar[int]
    reconstruction: bool
    deformed: bool
    probability: bool
    displacement: bool
    scene: bool
    def __init__(self, reconstruction: bool = ..., deformed: bool = ..., probability: bool = ..., displacement: bool = ..., scene: bool = ...) -> None: ...

class DeformResponse(_message.Message):
    __slots__ = ("request_id", "model", "grid", "observed", "reconstruction", "reconstruction_probability", "loads", "flags", "timing_ms", "reconstruction_id", "scene")
    class TimingMsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    GRID_FIELD_NUMBER: _ClassVar[int]
    OBSERVED_FIELD_NUMBER: _ClassVar[int]
    RECONSTRUCTION_FIELD_NUMBER: _ClassVar[int]
    RECONSTRUCTION_PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    LOADS_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    TIMING_MS_FIELD_NUMBER: _ClassVar[int]
    RECONSTRUCTION_ID_FIELD_NUMBER: _ClassVar[int]
    SCENE_FIELD_NUMBER: _ClassVar[int]
    request_id: str
    model: ModelName
    grid: Grid
    observed: OccupancyGrid
    reconstruction: OccupancyGrid
    reconstruction_probability: ProbabilityGrid
    loads: _containers.RepeatedCompositeFieldContainer[LoadResult]
    flags: _containers.RepeatedScalarFieldContainer[str]
    timing_ms: _containers.ScalarMap[str, float]
    reconstruction_id: str
    scene: bytes
    def __init__(self, request_id: _Optional[str] = ..., model: _Optional[_Union[ModelName, _Mapping]] = ..., grid: _Optional[_Union[Grid, _Mapping]] = ..., observed: _Optional[_Union[OccupancyGrid, _Mapping]] = ..., reconstruction: _Optional[_Union[OccupancyGrid, _Mapping]] = ..., reconstruction_probability: _Optional[_Union[ProbabilityGrid, _Mapping]] = ..., loads: _Optional[_Iterable[_Union[LoadResult, _Mapping]]] = ..., flags: _Optional[_Iterable[str]] = ..., timing_ms: _Optional[_Mapping[str, float]] = ..., reconstruction_id: _Optional[str] = ..., scene: _Optional[bytes] = ...) -> None: ...

class ModelName(_message.Message):
    __slots__ = ("name", "version")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    name: str
    version: str
    def __init__(self, name: _Optional[str] = ..., version: _Optional[str] = ...) -> None: ...

class Grid(_message.Message):
    __slots__ = ("shape", "voxel_size_m", "camera_from_grid")
    SHAPE_FIELD_NUMBER: _ClassVar[int]
    VOXEL_SIZE_M_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FROM_GRID_FIELD_NUMBER: _ClassVar[int]
    shape: _containers.RepeatedScalarFieldContainer[int]
    voxel_size_m: float
    camera_from_grid: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, shape: _Optional[_Iterable[int]] = ..., voxel_size_m: _Optional[float] = ..., camera_from_grid: _Optional[_Iterable[float]] = ...) -> None: ...

class OccupancyGrid(_message.Message):
    __slots__ = ("bits",)
    BITS_FIELD_NUMBER: _ClassVar[int]
    bits: bytes
    def __init__(self, bits: _Optional[bytes] = ...) -> None: ...

class ProbabilityGrid(_message.Message):
    __slots__ = ("levels",)
    LEVELS_FIELD_NUMBER: _ClassVar[int]
    levels: bytes
    def __init__(self, levels: _Optional[bytes] = ...) -> None: ...

class DisplacementField(_message.Message):
    __slots__ = ("float16_m",)
    FLOAT16_M_FIELD_NUMBER: _ClassVar[int]
    float16_m: bytes
    def __init__(self, float16_m: _Optional[bytes] = ...) -> None: ...

class DisplacementAtVoxels(_message.Message):
    __slots__ = ("count", "float16_m")
    COUNT_FIELD_NUMBER: _ClassVar[int]
    FLOAT16_M_FIELD_NUMBER: _ClassVar[int]
    count: int
    float16_m: bytes
    def __init__(self, count: _Optional[int] = ..., float16_m: _Optional[bytes] = ...) -> None: ...

class LoadResult(_message.Message):
    __slots__ = ("deformed", "probability", "displacement", "max_displacement_m", "mean_displacement_m", "load_number", "flags", "displacement_at_voxels")
    DEFORMED_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    DISPLACEMENT_FIELD_NUMBER: _ClassVar[int]
    MAX_DISPLACEMENT_M_FIELD_NUMBER: _ClassVar[int]
    MEAN_DISPLACEMENT_M_FIELD_NUMBER: _ClassVar[int]
    LOAD_NUMBER_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    DISPLACEMENT_AT_VOXELS_FIELD_NUMBER: _ClassVar[int]
    deformed: OccupancyGrid
    probability: ProbabilityGrid
    displacement: DisplacementField
    max_displacement_m: float
    mean_displacement_m: float
    load_number: float
    flags: _containers.RepeatedScalarFieldContainer[str]
    displacement_at_voxels: DisplacementAtVoxels
    def __init__(self, deformed: _Optional[_Union[OccupancyGrid, _Mapping]] = ..., probability: _Optional[_Union[ProbabilityGrid, _Mapping]] = ..., displacement: _Optional[_Union[DisplacementField, _Mapping]] = ..., max_displacement_m: _Optional[float] = ..., mean_displacement_m: _Optional[float] = ..., load_number: _Optional[float] = ..., flags: _Optional[_Iterable[str]] = ..., displacement_at_voxels: _Optional[_Union[DisplacementAtVoxels, _Mapping]] = ...) -> None: ...

class DeformStreamRequest(_message.Message):
    __slots__ = ("frame_id", "request", "deadline_ms")
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    REQUEST_FIELD_NUMBER: _ClassVar[int]
    DEADLINE_MS_FIELD_NUMBER: _ClassVar[int]
    frame_id: int
    request: DeformRequest
    deadline_ms: float
    def __init__(self, frame_id: _Optional[int] = ..., request: _Optional[_Union[DeformRequest, _Mapping]] = ..., deadline_ms: _Optional[float] = ...) -> None: ...

class DeformStreamResponse(_message.Message):
    __slots__ = ("frame_id", "answer", "skipped", "problem", "age_ms")
    class AgeMsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    ANSWER_FIELD_NUMBER: _ClassVar[int]
    SKIPPED_FIELD_NUMBER: _ClassVar[int]
    PROBLEM_FIELD_NUMBER: _ClassVar[int]
    AGE_MS_FIELD_NUMBER: _ClassVar[int]
    frame_id: int
    answer: DeformResponse
    skipped: Skipped
    problem: Problem
    age_ms: _containers.ScalarMap[str, float]
    def __init__(self, frame_id: _Optional[int] = ..., answer: _Optional[_Union[DeformResponse, _Mapping]] = ..., skipped: _Optional[_Union[Skipped, _Mapping]] = ..., problem: _Optional[_Union[Problem, _Mapping]] = ..., age_ms: _Optional[_Mapping[str, float]] = ...) -> None: ...

class Skipped(_message.Message):
    __slots__ = ("overtaken_by_frame_id",)
    OVERTAKEN_BY_FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    overtaken_by_frame_id: int
    def __init__(self, overtaken_by_frame_id: _Optional[int] = ...) -> None: ...

class Problem(_message.Message):
    __slots__ = ("code", "detail", "field", "expected", "actual", "errors", "request_id", "retry_after_s")
    CODE_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    FIELD_FIELD_NUMBER: _ClassVar[int]
    EXPECTED_FIELD_NUMBER: _ClassVar[int]
    ACTUAL_FIELD_NUMBER: _ClassVar[int]
    ERRORS_FIELD_NUMBER: _ClassVar[int]
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    RETRY_AFTER_S_FIELD_NUMBER: _ClassVar[int]
    code: str
    detail: str
    field: str
    expected: _struct_pb2.Value
    actual: _struct_pb2.Value
    errors: _containers.RepeatedCompositeFieldContainer[FieldProblem]
    request_id: str
    retry_after_s: float
    def __init__(self, code: _Optional[str] = ..., detail: _Optional[str] = ..., field: _Optional[str] = ..., expected: _Optional[_Union[_struct_pb2.Value, _Mapping]] = ..., actual: _Optional[_Union[_struct_pb2.Value, _Mapping]] = ..., errors: _Optional[_Iterable[_Union[FieldProblem, _Mapping]]] = ..., request_id: _Optional[str] = ..., retry_after_s: _Optional[float] = ...) -> None: ...

class FieldProblem(_message.Message):
    __slots__ = ("field", "detail")
    FIELD_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    field: str
    detail: str
    def __init__(self, field: _Optional[str] = ..., detail: _Optional[str] = ...) -> None: ...

class ListMaterialsRequest(_message.Message):
    __slots__ = ("query",)
    QUERY_FIELD_NUMBER: _ClassVar[int]
    query: str
    def __init__(self, query: _Optional[str] = ...) -> None: ...

class ListMaterialsResponse(_message.Message):
    __slots__ = ("materials",)
    MATERIALS_FIELD_NUMBER: _ClassVar[int]
    materials: _containers.RepeatedCompositeFieldContainer[MaterialEntry]
    def __init__(self, materials: _Optional[_Iterable[_Union[MaterialEntry, _Mapping]]] = ...) -> None: ...

class MaterialEntry(_message.Message):
    __slots__ = ("name", "young_modulus_pa", "poisson_ratio", "young_modulus_min_pa", "young_modulus_max_pa", "description", "source")
    NAME_FIELD_NUMBER: _ClassVar[int]
    YOUNG_MODULUS_PA_FIELD_NUMBER: _ClassVar[int]
    POISSON_RATIO_FIELD_NUMBER: _ClassVar[int]
    YOUNG_MODULUS_MIN_PA_FIELD_NUMBER: _ClassVar[int]
    YOUNG_MODULUS_MAX_PA_FIELD_NUMBER: _ClassVar[int]
    DESCRIPTION_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    name: str
    young_modulus_pa: float
    poisson_ratio: float
    young_modulus_min_pa: float
    young_modulus_max_pa: float
    description: str
    source: str
    def __init__(self, name: _Optional[str] = ..., young_modulus_pa: _Optional[float] = ..., poisson_ratio: _Optional[float] = ..., young_modulus_min_pa: _Optional[float] = ..., young_modulus_max_pa: _Optional[float] = ..., description: _Optional[str] = ..., source: _Optional[str] = ...) -> None: ...

class GetModelRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class GetModelResponse(_message.Message):
    __slots__ = ("models",)
    MODELS_FIELD_NUMBER: _ClassVar[int]
    models: _containers.RepeatedCompositeFieldContainer[Model]
    def __init__(self, models: _Optional[_Iterable[_Union[Model, _Mapping]]] = ...) -> None: ...

class Model(_message.Message):
    __slots__ = ("name", "version", "kind", "threshold", "condition_range", "manifest_json")
    class ConditionRangeEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: Range
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[Range, _Mapping]] = ...) -> None: ...
    NAME_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    THRESHOLD_FIELD_NUMBER: _ClassVar[int]
    CONDITION_RANGE_FIELD_NUMBER: _ClassVar[int]
    MANIFEST_JSON_FIELD_NUMBER: _ClassVar[int]
    name: str
    version: str
    kind: str
    threshold: float
    condition_range: _containers.MessageMap[str, Range]
    manifest_json: str
    def __init__(self, name: _Optional[str] = ..., version: _Optional[str] = ..., kind: _Optional[str] = ..., threshold: _Optional[float] = ..., condition_range: _Optional[_Mapping[str, Range]] = ..., manifest_json: _Optional[str] = ...) -> None: ...

class Range(_message.Message):
    __slots__ = ("low", "high")
    LOW_FIELD_NUMBER: _ClassVar[int]
    HIGH_FIELD_NUMBER: _ClassVar[int]
    low: float
    high: float
    def __init__(self, low: _Optional[float] = ..., high: _Optional[float] = ...) -> None: ...
