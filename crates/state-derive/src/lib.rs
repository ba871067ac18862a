//! `#[derive(Plain)]` and `#[derive(State)]` of `posed-state`.

use proc_macro::TokenStream;
use proc_macro2::TokenStream as Code;
use quote::{format_ident, quote};
use syn::{Data, DeriveInput, Field, Fields, Ident, Index, Member, Type, parse_macro_input, parse_quote};

/// Writes and reads every field in its order; an enum's variant goes before them as one byte. A field with
/// `#[state(skip)]` is not written, and read as its default: room to work in.
#[proc_macro_derive(Plain, attributes(state))]
pub fn plain(input: TokenStream) -> TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    expand_plain(input).unwrap_or_else(syn::Error::into_compile_error).into()
}

/// Writes every field in its order, and reads them in place; the variant of an enum must be the one that is there.
///
/// A field with `#[state(keep)]` is neither written nor read: whoever made the value put it there. One with `#[state(same)]` is
/// written, and what is read must equal what is there: names. What a box holds is read in place with `#[state(inner)]`, the items
/// of a list one by one with `#[state(each)]`.
#[proc_macro_derive(State, attributes(state))]
pub fn state(input: TokenStream) -> TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    expand_state(input).unwrap_or_else(syn::Error::into_compile_error).into()
}

fn expand_plain(mut input: DeriveInput) -> syn::Result<Code> {
    for parameter in input.generics.type_params_mut() {
        parameter.bounds.push(parse_quote!(::posed_state::Plain));
    }
    let name = &input.ident;
    let (generics, arguments, bounds) = input.generics.split_for_impl();
    let (save, read, layout) = match &input.data {
        Data::Struct(data) => {
            let saved =
                members(&data.fields).into_iter().zip(&data.fields).filter(|(_, field)| !is_skipped(field));
            let save: Code =
                saved.map(|(member, _)| quote!(::posed_state::Plain::save(&self.#member, to);)).collect();
            let read = construct(quote!(Self), &data.fields);
            (save, quote!(::core::result::Result::Ok(#read)), layout(name, &data.fields))
        }
        Data::Enum(data) => {
            let (mut save, mut read, mut described) = (Code::new(), Code::new(), named(name));
            for (index, variant) in (0u8..).zip(&data.variants) {
                let ident = &variant.ident;
                let members = members(&variant.fields);
                let bound: Vec<Ident> = (0..members.len()).map(|k| format_ident!("field_{k}")).collect();
                save.extend(quote!(Self::#ident { #(#members: #bound),* } => {
                    to.byte(#index);
                    #(::posed_state::Plain::save(#bound, to);)*
                }));
                let made = construct(quote!(Self::#ident), &variant.fields);
                read.extend(quote!(#index => ::core::result::Result::Ok(#made),));
                let inner = layout(ident, &variant.fields);
                described = quote!(::posed_state::layout::join(#described, #inner));
            }
            let unknown =
                quote!(_ => ::core::result::Result::Err(::posed_state::Damaged::Word(stringify!(#name))));
            (quote!(match self { #save }), quote!(match from.byte()? { #read #unknown }), described)
        }
        Data::Union(_) => return Err(syn::Error::new_spanned(name, "a union has no one value")),
    };
    Ok(quote! {
        impl #generics ::posed_state::Plain for #name #arguments #bounds {
            const LAYOUT: u64 = #layout;
            fn save(&self, to: &mut ::posed_state::Writer) { #save }
            fn read(from: &mut ::posed_state::Reader<'_>) -> ::core::result::Result<Self, ::posed_state::Damaged> {
                #read
            }
        }
    })
}

fn expand_state(input: DeriveInput) -> syn::Result<Code> {
    let name = &input.ident;
    let (generics, arguments, bounds) = input.generics.split_for_impl();
    let (save, load, layout) = match &input.data {
        Data::Struct(data) => {
            let place = |member: &Member| quote!(self.#member);
            let parts = Parts::new(named(name), &data.fields, place)?;
            (parts.save, parts.load, parts.layout)
        }
        Data::Enum(data) => {
            let (mut save, mut load, mut described) = (Code::new(), Code::new(), named(name));
            for (index, variant) in (0u8..).zip(&data.variants) {
                let ident = &variant.ident;
                let bound = |member: &Member| format_ident!("field_{}", text(member));
                let place = |member: &Member| {
                    let bound = bound(member);
                    quote!((*#bound))
                };
                let parts = Parts::new(named(ident), &variant.fields, place)?;
                let members = members(&variant.fields);
                let bound: Vec<Ident> = members.iter().map(bound).collect();
                let (save_parts, load_parts, inner) = (parts.save, parts.load, parts.layout);
                save.extend(quote!(Self::#ident { #(#members: #bound),* } => {
                    to.byte(#index);
                    #save_parts
                }));
                load.extend(quote!((Self::#ident { #(#members: #bound),* }, #index) => { #load_parts }));
                described = quote!(::posed_state::layout::join(#described, #inner));
            }
            let other = quote!(_ => return ::core::result::Result::Err(::posed_state::Damaged::OtherParts));
            (quote!(match self { #save }), quote!(match (self, from.byte()?) { #load #other }), described)
        }
        Data::Union(_) => return Err(syn::Error::new_spanned(name, "a union has no one state")),
    };
    Ok(quote! {
        impl #generics ::posed_state::State for #name #arguments #bounds {
            const LAYOUT: u64 = #layout;
            fn save_state(&self, to: &mut ::posed_state::Writer) { #save }
            fn load_state(&mut self, from: &mut ::posed_state::Reader<'_>) -> ::core::result::Result<(), ::posed_state::Damaged> {
                #load
                ::core::result::Result::Ok(())
            }
        }
    })
}

/// Code for the fields of a state.
struct Parts {
    save: Code,
    load: Code,
    layout: Code,
}

impl Parts {
    /// `place` is the expression of a field.
    fn new(layout: Code, fields: &Fields, place: impl Fn(&Member) -> Code) -> syn::Result<Self> {
        let mut parts = Self { save: Code::new(), load: Code::new(), layout };
        for (member, field) in members(fields).iter().zip(fields) {
            let (at, inner) = (place(member), innermost(&field.ty));
            let kind = match way(field)? {
                Way::Keep => continue,
                Way::Same => {
                    let kind = &field.ty;
                    parts.save.extend(quote!(<#kind as ::posed_state::Plain>::save(&#at, to);));
                    parts.load.extend(quote! {
                        if <#kind as ::posed_state::Plain>::read(from)? != #at {
                            return ::core::result::Result::Err(::posed_state::Damaged::OtherParts);
                        }
                    });
                    kind
                }
                Way::Whole => {
                    parts.save.extend(quote!(::posed_state::State::save_state(&#at, to);));
                    parts.load.extend(quote!(::posed_state::State::load_state(&mut #at, from)?;));
                    &field.ty
                }
                Way::Inner => {
                    parts.save.extend(quote!(<#inner as ::posed_state::State>::save_state(&#at, to);));
                    parts.load.extend(quote!(<#inner as ::posed_state::State>::load_state(&mut #at, from)?;));
                    inner
                }
                Way::Each => {
                    parts.save.extend(quote! {
                        to.length(#at.iter().count());
                        for item in #at.iter() { <#inner as ::posed_state::State>::save_state(item, to); }
                    });
                    parts.load.extend(quote! {
                        from.same_length(#at.iter().count())?;
                        for item in #at.iter_mut() { <#inner as ::posed_state::State>::load_state(item, from)?; }
                    });
                    inner
                }
            };
            let (before, text) = (&parts.layout, text(member));
            parts.layout =
                quote!(::posed_state::layout::field(#before, #text, <#kind as ::posed_state::State>::LAYOUT));
        }
        Ok(parts)
    }
}

enum Way {
    Whole,
    Keep,
    Same,
    Inner,
    Each,
}

fn way(field: &Field) -> syn::Result<Way> {
    let Some(attribute) = field.attrs.iter().find(|attribute| attribute.path().is_ident("state")) else {
        return Ok(Way::Whole);
    };
    match attribute.parse_args::<Ident>()?.to_string().as_str() {
        "keep" => Ok(Way::Keep),
        "same" => Ok(Way::Same),
        "inner" => Ok(Way::Inner),
        "each" => Ok(Way::Each),
        _ => Err(syn::Error::new_spanned(attribute, "expected `keep`, `same`, `inner` or `each`")),
    }
}

fn is_skipped(field: &Field) -> bool {
    let skip = |attribute: &syn::Attribute| {
        attribute.path().is_ident("state") && attribute.parse_args::<Ident>().is_ok_and(|word| word == "skip")
    };
    field.attrs.iter().any(skip)
}

/// `T` of `Vec<T>`, `Box<T>`, `Option<Box<T>>`, `[T; N]`.
fn innermost(kind: &Type) -> &Type {
    match kind {
        Type::Array(array) => &array.elem,
        Type::Path(path) => match path.path.segments.last().map(|segment| &segment.arguments) {
            Some(syn::PathArguments::AngleBracketed(inner)) => match inner.args.first() {
                Some(syn::GenericArgument::Type(inner)) => innermost(inner),
                _ => kind,
            },
            _ => kind,
        },
        _ => kind,
    }
}

fn members(fields: &Fields) -> Vec<Member> {
    fields
        .iter()
        .enumerate()
        .map(|(index, field)| match &field.ident {
            Some(ident) => Member::Named(ident.clone()),
            None => Member::Unnamed(Index::from(index)),
        })
        .collect()
}

fn text(member: &Member) -> String {
    match member {
        Member::Named(ident) => ident.to_string(),
        Member::Unnamed(index) => index.index.to_string(),
    }
}

fn construct(path: Code, fields: &Fields) -> Code {
    let read = members(fields).into_iter().zip(fields).map(|(member, field)| {
        if is_skipped(field) {
            quote!(#member: ::core::default::Default::default(),)
        } else {
            quote!(#member: ::posed_state::Plain::read(from)?,)
        }
    });
    quote!(#path { #(#read)* })
}

fn named(name: &Ident) -> Code {
    quote!(::posed_state::layout::name(stringify!(#name)))
}

fn layout(name: &Ident, fields: &Fields) -> Code {
    let mut layout = named(name);
    for (member, field) in members(fields).iter().zip(fields).filter(|(_, field)| !is_skipped(field)) {
        let (text, kind) = (text(member), &field.ty);
        layout =
            quote!(::posed_state::layout::field(#layout, #text, <#kind as ::posed_state::Plain>::LAYOUT));
    }
    layout
}
