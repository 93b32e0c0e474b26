#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod agent;
mod ddpg;
mod networks;
mod td3;
#[cfg(test)]
mod tests;
mod torchscript;

pub use agent::{Bf16, F32};
pub use ddpg::Ddpg;
pub use td3::Td3;
pub use torchscript::TorchScript;

shield_api::export_plugin! {
    learner "ddpg-torch" => Ddpg<F32> { description: "ddpg on libtorch, on the graphics card where there is one", deterministic: false }
    learner "ddpg-torch-bf16" => Ddpg<Bf16> { description: "ddpg-torch with matrix products in bfloat16", deterministic: false }
    learner "td3-torch" => Td3<F32> { description: "td3 on libtorch, on the graphics card where there is one", deterministic: false }
    learner "td3-torch-bf16" => Td3<Bf16> { description: "td3-torch with matrix products in bfloat16", deterministic: false }
    policy "torchscript" => TorchScript { description: "Plays a policy that torch has exported to a .pt file", deterministic: false }
}
