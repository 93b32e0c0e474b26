//! The table of environments and those of their extensions, filled for a type that implements the trait.

use std::ffi::c_void;

use super::{
    kinds::descriptor,
    life::{self, buffer, call, copy_text, required},
};
use crate::{
    Environment, Frame, Plugin,
    abi::{
        CostsTable, EXTENSION_COSTS, EXTENSION_RENDER, EXTENSION_STARTS, EnvironmentTable, Floats, Instance,
        LifeTable, PluginDescriptor, RenderTable, SpaceView, SpecView, StartsTable, StepView, Text, kind,
    },
};

/// The entry of an environment in a library's list.
pub const fn environment<T: Environment + Plugin>(manifest: &'static [u8]) -> PluginDescriptor {
    let table = const {
        &EnvironmentTable {
            struct_size: size_of::<EnvironmentTable>(),
            life: LifeTable { get_extension: environment_extension::<T>, ..life::table::<T>() },
            spec: spec::<T>,
            reset: reset::<T>,
            step: step::<T>,
        }
    };
    PluginDescriptor { environment: table, ..descriptor(kind::ENVIRONMENT, manifest) }
}

// Every function below is called by a host that keeps the promises of the table: an instance that `create` of the same table
// made, used by one thread at a time, and pointers that are null or valid for the length given with them.

unsafe extern "C" fn spec<T: Environment>(instance: *mut Instance, view: *mut SpecView) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let view = required(view, "the place for the spec")?;
            let spec = holder.spec.insert(holder.value.spec());
            view.observation_space = SpaceView::new(&spec.spaces.observation);
            view.action_space = SpaceView::new(&spec.spaces.action);
            view.episode_length = u32::try_from(spec.episode_length).unwrap_or(u32::MAX);
            view.brings_reset_reward = u32::from(spec.brings_reset_reward);
            Ok(())
        })
    }
}

unsafe extern "C" fn reset<T: Environment>(
    instance: *mut Instance,
    seed: u64,
    observation: *mut f32,
    length: usize,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| holder.value.reset(seed, buffer(observation, length, "observation")?))
    }
}

unsafe extern "C" fn step<T: Environment>(
    instance: *mut Instance,
    action: Floats,
    observation: *mut f32,
    length: usize,
    view: *mut StepView,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let view = required(view, "the place for the outcome")?;
            let observation = buffer(observation, length, "observation")?;
            *view = holder.value.step(action.as_slice(), observation)?.into();
            Ok(())
        })
    }
}

unsafe extern "C" fn environment_extension<T: Environment>(name: Text) -> *const c_void {
    let starts: &'static StartsTable = const {
        &StartsTable { struct_size: size_of::<StartsTable>(), name: start_name::<T>, reset_to: reset_to::<T> }
    };
    let costs: &'static CostsTable = const {
        &CostsTable {
            struct_size: size_of::<CostsTable>(),
            kind: reset_kind_of::<T>,
            present: present_reset_kind::<T>,
        }
    };
    let render: &'static RenderTable = const {
        &RenderTable { struct_size: size_of::<RenderTable>(), size: frame_size::<T>, render: render::<T> }
    };
    // SAFETY: the host's text lives for the call.
    match unsafe { name.as_str() } {
        EXTENSION_STARTS => std::ptr::from_ref(starts).cast(),
        EXTENSION_COSTS => std::ptr::from_ref(costs).cast(),
        EXTENSION_RENDER => std::ptr::from_ref(render).cast(),
        _ => std::ptr::null(),
    }
}

unsafe extern "C" fn reset_kind_of<T: Environment>(
    instance: *mut Instance,
    index: usize,
    out: *mut u8,
    capacity: usize,
    cost: *mut f64,
) -> usize {
    let mut length = 0;
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            if let Some(kind) = holder.value.reset_kinds().get(index) {
                *required(cost, "the place for the cost")? = kind.cost;
                length = copy_text(&kind.name, out, capacity);
            }
            Ok(())
        });
    }
    length
}

unsafe extern "C" fn present_reset_kind<T: Environment>(instance: *mut Instance, index: *mut usize) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            *required(index, "the place for the kind")? = holder.value.reset_kind()?;
            Ok(())
        })
    }
}

unsafe extern "C" fn frame_size<T: Environment>(
    instance: *mut Instance,
    width: *mut u32,
    height: *mut u32,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let size = holder.value.frame_size().map(|pixels| u32::try_from(pixels).unwrap_or(u32::MAX));
            *required(width, "the place for the width")? = size[0];
            *required(height, "the place for the height")? = size[1];
            Ok(())
        })
    }
}

unsafe extern "C" fn render<T: Environment>(
    instance: *mut Instance,
    width: u32,
    height: u32,
    shades: Floats,
    pixels: *mut u8,
    length: usize,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            let pixels = buffer(pixels, length, "pixels")?;
            let frame = Frame::new(width as usize, height as usize, pixels)?;
            holder.value.render(&mut frame.with_shades(shades.as_slice()))
        })
    }
}

unsafe extern "C" fn start_name<T: Environment>(
    instance: *mut Instance,
    index: usize,
    out: *mut u8,
    capacity: usize,
) -> usize {
    let mut length = 0;
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            if let Some(name) = holder.value.starts().get(index) {
                length = copy_text(name, out, capacity);
            }
            Ok(())
        });
    }
    length
}

unsafe extern "C" fn reset_to<T: Environment>(
    instance: *mut Instance,
    start: Text,
    seed: u64,
    observation: *mut f32,
    length: usize,
) -> i32 {
    // SAFETY: the host's promises, as said above.
    unsafe {
        call::<T>(instance, |holder| {
            holder.value.reset_to(start.as_str(), seed, buffer(observation, length, "observation")?)
        })
    }
}
