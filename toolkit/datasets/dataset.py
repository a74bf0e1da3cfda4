"""A recording of images as one HDF5 file: the published layout, with our fields in `coview`.

`CoopDataset` reads files of `coview simulate` and the published ones alike
(`toolkit.datasets.recording_file` writes them).

dslices                float32 [T, C, H, W]  depth along the axis (m), 1000 where nothing returned;
                                             only every stride-th pixel is measured, the others
                                             hold 0
slices                 uint8 [T, 0, H, W, 3] no colour images; the published viewer asks for their
                                             number
cameras/{d00..}        intrinsic, extrinsic  in the published convention; attributes name, stride,
                                             sigma, ...
objects/{k}            float64 [n, 10]       see `toolkit.datasets.published_layout`
coview                 attributes            schema, version, plan, sensors (names, in the order of
                                             a Frame's measurements)
coview/site            text                  the site as GeoJSON
coview/bodies          JSON list             names of the bodies
coview/time            float64 [T]           seconds
coview/object_start    int64 [T + 1]         frame k has objects object_start[k]:object_start[k + 1]
                                             of the next two
coview/object_ids, coview/object_bodies      int64 [N]
coview/ranges/{name}   float32 [T, rows, columns]  a lidar's ranges (m), 0 where nothing returned;
                                             attributes as for cameras: name, model (its class),
                                             fields of the model
coview/depth/{name}    float32 [T, rows, columns]  depths that cannot share `dslices`: cameras that
                                             differ in size"""

import operator
import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import SupportsIndex, overload

import h5py
import numpy as np

from toolkit.arrays import ImageRanges
from toolkit.datasets import published_layout as published
from toolkit.datasets.image_file import check_kinds, object_rows, open_file
from toolkit.datasets.stored_channels import list_channels
from toolkit.datasets.stored_site import find_stored_site
from toolkit.frame import DisplayedRecording, Frame, Rectangle
from toolkit.objects import LABELS, Objects
from toolkit.runtime import hdf5
from toolkit.sites.site import Site


class CoopDataset(DisplayedRecording, Sequence[Frame]):
    """Noise-free frames of an HDF5 file, in the site frame.

    `dataset[k]` is a `Frame`; a slice is a list of frames. The file is opened when needed, and
    again in every process it is sent to. Usable in a `with` statement.

    path: a file of `coview simulate` or one in the published layout. site: the site that it shows;
    our files name it, published ones are recognised if they show a built-in site. drop_invalid:
    leave out rows that no object can have (NaN, no size, kilometres away, see
    `published_layout.wrong_rows`), with one warning that counts them. Otherwise reading a frame
    with such a row raises ValueError.

    Raises FileNotFoundError; OSError for a file that is cut off or not HDF5; ValueError, which
    names the fault in the file, for another layout; IndexError for an unknown frame."""

    def __init__(
        self, path: str | Path, site: Site | None = None, *, drop_invalid: bool = False
    ) -> None:
        """Open the file, check its datasets, and read the times and the numbers of objects."""
        self.path = Path(path)
        self.drop_invalid = drop_invalid
        self._open: tuple[int, h5py.File, dict[str, h5py.Dataset]] | None = None
        file, _ = self._file()
        try:
            cameras = check_kinds(file)
            self.site = site if site is not None else find_stored_site(file, cameras)
            self.channels = list_channels(file, cameras, self.site)
            self.sensors = tuple(channel.sensor for channel in self.channels)
            xmin, ymin, xmax, ymax = self.site.area.tolist()
            self._area = Rectangle((xmin, ymin, xmax, ymax))
            self.times = hdf5.find_array(file, "coview/time", axes=1)
            self._starts = hdf5.find_array(file, "coview/object_start", axes=1)
            lengths = {
                channel.name: self.open_dataset(channel.name).shape[0] for channel in self.channels
            }
            lengths |= {} if self.times is None else {"coview/time": len(self.times)}
            if len(set(lengths.values())) != 1:
                raise ValueError(
                    f"its datasets must have one length, the number of frames, got {lengths}"
                )
            self._length = next(iter(lengths.values()))
            starts = self._starts
            count = self._length + 1
            is_valid = starts is None or (starts.dtype.kind in "iu" and len(starts) == count)
            if starts is not None and (
                not is_valid or (np.diff(starts.astype(np.int64)) < 0).any()
            ):
                got = f"{len(starts)} of {starts.dtype}"
                raise ValueError(
                    f"coview/object_start must be {count} whole numbers that ascend, got {got}"
                )
            if drop_invalid:
                self._warn_of_invalid(file)
        except (ValueError, OSError) as error:
            self.close()
            raise type(error)(f"{path}: {error}") from None

    def __len__(self) -> int:
        return self._length

    @overload
    def __getitem__(self, index: SupportsIndex) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> list[Frame]: ...
    def __getitem__(self, index: SupportsIndex | slice) -> Frame | list[Frame]:
        """Frame of an index, or list of frames of a slice; negative indices count from the end."""
        if isinstance(index, slice):
            return [self._frame(number) for number in range(*index.indices(len(self)))]
        number = operator.index(index)
        if not -len(self) <= number < len(self):
            raise IndexError(
                f"frame {number} is out of range: {self.path} has {len(self)} frames, 0 to "
                f"{len(self) - 1}"
            )
        return self._frame(number % len(self))

    def __iter__(self) -> Iterator[Frame]:
        return (self._frame(k) for k in range(len(self)))

    def close(self) -> None:
        """Close the file; the next access opens it again."""
        if self._open is not None and self._open[0] == os.getpid():
            self._open[1].close()
        self._open = None

    def open_dataset(
        self, name: str, *, axes: int | None = None, kinds: str = "fiu"
    ) -> h5py.Dataset:
        """Return a dataset of the file by its path; it is checked on first use and then kept.

        axes: required number of axes, None for any; kinds: NumPy kinds that its type may have."""
        file, datasets = self._file()
        if name not in datasets:
            datasets[name] = hdf5.dataset(file, name, axes=axes, kinds=kinds)
        return datasets[name]

    def __enter__(self) -> "CoopDataset":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_open": None}

    def _file(self) -> tuple[h5py.File, dict[str, h5py.Dataset]]:
        """Return the open file, opened if need be, and its datasets that are checked already."""
        # a forked process must not share the parent's handle
        if self._open is None or self._open[0] != os.getpid():
            self._open = os.getpid(), open_file(self.path), {}
        file, datasets = self._open[1:]
        return file, datasets

    def _frame(self, number: int) -> Frame:
        """Read a frame by its number, from 0. Its world coordinates are the site's."""
        file, _ = self._file()
        with self._name_errors(number):
            measurements = self._read_images(number)
            objects = self._objects(file, number)
        return Frame(
            sensors=self.sensors,
            measurements=measurements,
            objects=objects,
            time=0.0 if self.times is None else float(self.times[number]),
            index=number,
            name=f"{number:06d}",
            categories=tuple(LABELS[label] for label in objects.labels.tolist()),
            complete=self._area,  # labels are complete within this area
            map_SE3_world=self.site.map_SE3_site,
        )

    def read_objects(self, number: int) -> Objects:
        """Read the objects of a frame by its number, from 0, without its measurements."""
        file, _ = self._file()
        with self._name_errors(number):
            return self._objects(file, number)

    @property
    def has_ids(self) -> bool:
        """True if an id of an object is the same road user in all frames."""
        return self._starts is not None

    @contextmanager
    def _name_errors(self, number: int) -> Iterator[None]:
        """Name the file and the frame of a number in errors of reading."""
        try:
            yield
        except OSError as error:
            raise OSError(f"{self.path}: frame {number} cannot be read: {error}") from None
        except ValueError as error:
            raise type(error)(f"{self.path}: frame {number}: {error}") from None

    def _read_images(self, number: int) -> tuple[ImageRanges, ...]:
        """Read the image of each sensor (m, 0 for no return) in the frame of a number.

        A channel with a `depth_index` shares its dataset with others, in the published form: the
        full image, with only every `stride`-th pixel measured."""
        dataset_names = dict.fromkeys(channel.name for channel in self.channels)
        arrays = {name: hdf5.rows(self.open_dataset(name), name, number) for name in dataset_names}
        full_images = [
            (arrays[channel.name][channel.depth_index], channel.stride)
            for channel in self.channels
            if channel.depth_index is not None
        ]
        shared_images = iter(published.measure_images(full_images))  # in the order of channels
        images = []
        for channel in self.channels:
            if channel.depth_index is None:
                images.append(arrays[channel.name].astype(np.float32))
            else:
                images.append(next(shared_images))
        return tuple(images)

    def _objects(self, file: h5py.File, number: int) -> Objects:
        """Read the objects in the frame of a number, with track ids if the file has them.

        Rows that no object can have raise ValueError, or are left out if `self.drop_invalid`."""
        name = f"objects/{number}"
        ids = None
        rows = object_rows(file, name)
        if self._starts is not None:
            # the ids of all frames are one after the other
            start, end = self._starts[number : number + 2].tolist()
            all_ids = self.open_dataset("coview/object_ids", axes=1, kinds="iu")
            ids = hdf5.rows(all_ids, "coview/object_ids", slice(start, end))
            if len(ids) != len(rows):
                raise ValueError(
                    f"{name} has {len(rows)} rows, but there are {len(ids)} coview/object_ids for "
                    "it"
                )
        if self.drop_invalid:
            is_sound = published.wrong_rows(rows) == ""
            rows = rows[is_sound]
            ids = None if ids is None else ids[is_sound]
        return published.parse_rows(rows, self.site.map_SE3_site, ids, name)

    def _warn_of_invalid(self, file: h5py.File) -> None:
        """Warn how many faulty objects of the file are left out, and describe the first fault."""
        faults_of_frame: dict[int, np.ndarray] = {}  # a text for each object, "" for no fault
        for number in range(self._length):
            faults = published.wrong_rows(object_rows(file, f"objects/{number}"))
            if (faults != "").any():
                faults_of_frame[number] = faults
        if faults_of_frame:
            count = sum(int((faults != "").sum()) for faults in faults_of_frame.values())
            first_frame, faults = next(iter(faults_of_frame.items()))
            # first object with a fault
            row = int((faults != "").argmax())
            example = f"objects/{first_frame} row {row}, which {faults[row]}"
            left_out = f"{self.path}: {count} objects in {len(faults_of_frame)} frames are left out"
            warnings.warn(f"{left_out}, the first is {example}", stacklevel=4)
